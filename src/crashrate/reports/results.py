"""The estimate, read back from result.json."""

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, TypeVar

from crashrate.errors import StoreError
from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.estimation.consequence import Consequence
from crashrate.estimation.estimate import Estimate, HistoryPoint
from crashrate.estimation.order_audit import OrderAudit
from crashrate.estimation.suspect import Suspect
from crashrate.estimation.traffic_range import TrafficRange
from crashrate.reports.numbers import is_number, number

Part = TypeVar("Part", OrderAudit, Suspect)


def estimate_of(result: Mapping[str, Any]) -> Estimate:
    """The estimate whose `to_dict` is `result`; None, written for what is not finite, becomes NaN.

    Parameters
    ----------
    result : mapping
        As in result.json.

    Raises
    ------
    StoreError
        If something is missing, or is not known to this version.
    """
    try:
        return _estimate(result)
    except (KeyError, TypeError, ValueError) as error:
        raise StoreError(
            f"result.json: expected what this version of crashrate writes, got {error!r}; write it "
            "again with 'crashrate run' and the same arguments (no simulator run is repeated)."
        ) from error


def _estimate(result: Mapping[str, Any]) -> Estimate:
    return Estimate(
        probability=number(result, "probability"),
        confidence=number(result, "confidence"),
        standard_error=number(result, "standard_error"),
        n_eff=number(result, "n_eff"),
        largest_weight_share=number(result, "largest_weight_share"),
        log_efficiency=number(result, "log_efficiency"),
        n_calls=_count(result, "n_calls"),
        n_crashes=_count(result, "n_crashes"),
        n_failed=_count(result, "n_failed"),
        seed=_count(result, "seed"),
        interval=_pair(result.get("interval")),
        bounds=_pair(result.get("bounds")),
        alarms=tuple(Alarm[alarm["name"]] for alarm in result.get("alarms", ())),
        stop_reason=StopReason(result["stop_reason"]),
        method=str(result["method"]),
        history=tuple(_point(p) for p in result.get("history", ())),
        traffic_range=_range(result.get("traffic_range")),
        goal=str(result.get("goal", "probability")),
        order_audit=_part(OrderAudit, result.get("order_audit")),
        order_suspect=_part(Suspect, result.get("order_suspect")),
        consequences=tuple(map(_consequence, result.get("consequences", ()))),
    )


def _consequence(found: Mapping[str, Any]) -> Consequence:
    return Consequence(
        name=str(found["name"]),
        mean=number(found, "mean"),
        interval=_pair(found["interval"]),
        standard_error=number(found, "standard_error"),
        n_eff=number(found, "n_eff"),
        n_carrying=_count(found, "n_carrying"),
        largest_weight_share=number(found, "largest_weight_share"),
        aimed=bool(found["aimed"]),
        traffic_range=_range(found.get("traffic_range")),
    )


def _part(kind: type[Part], found: Mapping[str, Any] | None) -> Part | None:
    if found is None:
        return None
    return kind(**{field.name: found[field.name] for field in fields(kind)})


def _range(found: Mapping[str, Any] | None) -> TrafficRange | None:
    if found is None:
        return None
    return TrafficRange(tuple(found["probabilities"]), tuple(found["standard_errors"]))


def _count(result: Mapping[str, Any], key: str) -> int:
    return int(result.get(key) or 0)


def _point(point: Mapping[str, Any]) -> HistoryPoint:
    return HistoryPoint(
        n_calls=int(point["n_calls"]),
        probability=number(point, "probability"),
        lower=number(point, "lower"),
        upper=number(point, "upper"),
        phase=str(point.get("phase", "")),
    )


def _pair(pair: Any) -> tuple[float, float]:
    low, high = pair if pair is not None else (math.nan, math.nan)
    return (low if is_number(low) else math.nan, high if is_number(high) else math.nan)
