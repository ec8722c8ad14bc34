"""The result file of a run: the estimate and what it was made from, as JSON."""

import json
from pathlib import Path
from typing import Any

from crashrate.errors import StoreError
from crashrate.estimation.estimate import Estimate
from crashrate.estimation.strategy import Problem
from crashrate.runs.configuration import versions
from crashrate.runs.scenario import Scenario
from crashrate.traffic.model import TrafficModel

RESULT, REPORT = "result.json", "report.html"
REQUIRED = ("schema", "probability", "interval", "n_calls", "stop_reason", "synthetic")


def is_synthetic(traffic: TrafficModel) -> bool:
    """Whether the model was fitted to events that were drawn, not recorded."""
    return bool(_events(traffic).get("synthetic", False))


def result_dict(
    estimate: Estimate, scenario: Scenario, problem: Problem, n_members: int
) -> dict[str, Any]:
    """What `result.json` holds; `n_members` are the traffic model's, used by the method or not."""
    traffic = problem.traffic
    return estimate.to_dict(scenario.outcome.per) | {
        "sentence": estimate.sentence(scenario.outcome.event, scenario.outcome.per),
        "target": {
            "relative_half_width": problem.relative_half_width,
            "max_calls": problem.max_calls,
            "aim": problem.aim,
        },
        "scenario": scenario.name,
        "traffic": {
            "variables": list(traffic.names),
            "n_components": traffic.n_components,
            "n_members": n_members,
            "events": {k: v for k, v in _events(traffic).items() if k != "sample"},
        },
        "synthetic": is_synthetic(traffic),
        "versions": versions(),
    }


def write_result(directory: Path, result: dict[str, Any]) -> Path:
    """Write `result.json`, the old one or the new one whole at any moment."""
    path, temporary = directory / RESULT, directory / f"{RESULT}.new"
    text = json.dumps(result, indent=2, allow_nan=False, ensure_ascii=False)
    try:
        temporary.write_text(text + "\n", encoding="utf-8")
        temporary.replace(path)
    except OSError as error:
        raise StoreError(f"{path}: expected a file to write to, got: {error}.") from error
    return path


def read_result(directory: Path) -> dict[str, Any]:
    """What `result.json` in the run folder says.

    Raises
    ------
    StoreError
        If it is missing or damaged.
    """
    path = directory / RESULT
    try:
        result = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise StoreError(
            f"{path}: no result yet; start or resume the run with 'crashrate run'."
        ) from None
    except (OSError, ValueError) as error:
        raise _damaged(path, "JSON", error) from error
    if not isinstance(result, dict) or any(key not in result for key in REQUIRED):
        raise _damaged(path, f"the keys {', '.join(REQUIRED)}", "something else")
    return result


def _damaged(path: Path, expected: str, got: object) -> StoreError:
    return StoreError(
        f"{path}: damaged: expected {expected}, got: {got}; write it again with 'crashrate run' "
        "and the same arguments (no simulator run is repeated)."
    )


def _events(traffic: TrafficModel) -> dict[str, Any]:
    return dict(traffic.provenance.get("events") or {})
