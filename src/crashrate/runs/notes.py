"""What is neither an answer nor a doubt, and yet to be known with either: in print and report."""

from collections.abc import Mapping
from typing import Any

from crashrate.estimation.alarms import Alarm
from crashrate.estimation.methods import LEARNING, TELL_MEMBERS


def notes(result: Mapping[str, Any]) -> tuple[str, ...]:
    """Sentences, without a full stop, on what `result.json` rests on that nobody checked."""
    recordings = result.get("recordings") or {}
    found = []
    if pending := recordings.get("pending"):
        found.append(pending)
    if unchecked := recordings.get("unchecked"):
        found.append(f"the traffic model is not checked against recordings: {unchecked}")
        if _is_by_order(result):
            found.append(
                "the risk order was taken to hold in plain traffic, and no recording was replayed: "
                "crashes that it denies there may have gone unseen"
            )
    if _is_one_fit(result):
        found.append(
            "one fit to the events, and no others beside it: nothing says how far the events "
            "determine this number; 'crashrate fit --ensemble 40' and a run in a new folder would"
        )
    if edits := result.get("vouched_sources"):
        found.append(
            f"the simulator was edited after {edits[-1]['n_runs']:,} runs; the outcomes from "
            "before were kept, at the user's word that they are the same (--same-vehicle)"
        )
    return tuple(found)


def _is_by_order(result: Mapping[str, Any]) -> bool:
    """Whether a risk order stood in for random encounters, to the end."""
    alarms = {alarm["name"] for alarm in result["alarms"]}
    free = {Alarm.NO_ORDER.name, Alarm.ORDER_DROPPED.name}
    return result["method"] in LEARNING and alarms.isdisjoint(free)


def _is_one_fit(result: Mapping[str, Any]) -> bool:
    """Whether the traffic model is the only one that was fitted to recorded events."""
    traffic = result.get("traffic") or {}
    fitted = bool((traffic.get("events") or {}).get("n")) and not result["synthetic"]
    told = result["method"] in TELL_MEMBERS  # the others leave out what members there are
    return fitted and told and not traffic.get("n_members")
