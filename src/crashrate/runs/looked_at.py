"""What `result.json` says of the recordings: what they said, or why nobody looked."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from crashrate.errors import StoreError
from crashrate.estimation.alarms import Alarm
from crashrate.estimation.estimate import Estimate, json_ready
from crashrate.estimation.methods import LEARNING
from crashrate.events import INVALID_SHARE, invalid_share
from crashrate.recordings.check import Check
from crashrate.runs.result import read_result
from crashrate.traffic.model import TrafficModel

PENDING, UNCHECKED = "pending", "unchecked"
# in the place of what the recordings say, until they have been looked at
NOT_YET = "the recordings are not replayed yet: the same 'run' command does it"
NO_EVENTS = "no events were at hand"


def entry(found: Check | None, estimate: Estimate, unchecked: str) -> dict[str, Any]:
    """The entry of `result.json`.

    Parameters
    ----------
    found : Check or None
        What the recordings said; None where they were not looked at.
    estimate : Estimate
    unchecked : str
        Why they will not be; empty where they will.
    """
    if found is not None:
        values: dict[str, Any] = json_ready(found.to_dict())
        return values | {"sentences": found.sentences(estimate)}
    return {UNCHECKED: unchecked} if unchecked else {PENDING: NOT_YET}


def why_not_looked_at(result: Mapping[str, Any]) -> str:
    """Why a result says nothing of the recordings; empty where it does."""
    found = result.get("recordings") or {UNCHECKED: NO_EVENTS}  # an earlier version left it out
    return str(found.get(UNCHECKED) or found.get(PENDING) or "")


def unchecked_by(method: str) -> str:
    """Why a method cannot look at the recordings; empty where it can."""
    return "" if method in LEARNING else f"the method {method!r} learns no crash set"


def why_unsettled(estimate: Estimate) -> str:
    """Why a campaign that has ended learned nothing by which events could be settled."""
    if not estimate.n_crashes:
        return "no crash was found, so nothing was learned that could settle the recorded events"
    return "the campaign learned too little to settle the recorded events"


def found_before(directory: Path, estimate: Estimate) -> Check | None:
    """What the recordings said of this very estimate when they were last looked at."""
    try:
        before = read_result(directory)
        same = (before["n_calls"], before["probability"]) == (
            estimate.n_calls,
            json_ready(estimate.probability),
        )
        return Check.from_dict(before["recordings"]) if same else None
    except (StoreError, KeyError, TypeError, ValueError):  # none, or of an earlier version
        return None


def doubted(estimate: Estimate, traffic: TrafficModel, found: Check | None) -> Estimate:
    """The estimate with the alarms that its recordings raise."""
    events = traffic.provenance.get("events") or {}
    share = invalid_share(int(events.get("n") or 0), events.get("dropped") or {})
    dropped = (Alarm.EVENTS_DROPPED,) if share > INVALID_SHARE else ()
    said = () if found is None else found.alarms(estimate)
    return replace(estimate, alarms=tuple(dict.fromkeys((*estimate.alarms, *dropped, *said))))
