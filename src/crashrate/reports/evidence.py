"""The table of evidence: what the estimate rests on, each number with its meaning."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from crashrate.estimation.alarms import Alarm
from crashrate.estimation.estimate import Estimate, in_words
from crashrate.estimation.traffic_range import TrafficRange
from crashrate.estimation.width import width_text
from crashrate.reports.numbers import (
    MISSING,
    count,
    interval_text,
    is_number,
    percent,
    plain,
    power_of_ten,
)
from crashrate.reports.recordings import check_of
from crashrate.runs.record import RunRecord


@dataclass(frozen=True)
class Fact:
    """One line of the table."""

    name: str
    value: str
    meaning: str


def evidence(record: RunRecord, estimate: Estimate) -> tuple[Fact, ...]:
    """What the estimate rests on."""
    return (
        *_answer(record, estimate),
        *_runs(record, estimate),
        *_quality(estimate),
        *_efficiency(estimate),
        *_origin(record, estimate),
    )


def _relative(e: Estimate) -> str:
    width = width_text(e.probability, e.interval)
    return width and f" ({width})"


def _answer(record: RunRecord, e: Estimate) -> tuple[Fact, ...]:
    has_bounds = e.bounds != (0.0, 1.0) and all(map(is_number, e.bounds))
    low, high = (power_of_ten(b) for b in e.bounds)
    return (
        Fact(
            "Probability",
            power_of_ten(e.probability) if e.determined else _undetermined(e),
            "Of one encounter, drawn from traffic.",
        ),
        Fact(
            f"{100 * e.confidence:g} % interval",
            interval_text(e.interval) + _relative(e) if e.goal == "probability" else "none",
            "Made to hold the probability in that share of campaigns, for this traffic model and "
            "this simulator; what an alarm doubts may be outside it.",
        ),
        *_traffic_ranges(e),
        *_replay(record),
        Fact(
            "Bounds",
            f"{low} ≤ p ≤ {high}" if has_bounds else "none",
            _bounds_meaning(e) if has_bounds else "Nothing is implied about other situations.",
        ),
        *_order_audit(e),
        *_order_suspect(e),
    )


def _undetermined(e: Estimate) -> str:
    return (
        "not estimated: the runs went into its bounds" if e.goal == "bounds" else "not determined"
    )


def _order_suspect(e: Estimate) -> tuple[Fact, ...]:
    found = e.order_suspect
    if found is None:
        return ()
    name = found.coordinate
    meaning = f"{found.sentence()[0].upper()}{found.sentence()[1:]}."
    return (Fact("Suspect direction", name, meaning),)


def _order_audit(e: Estimate) -> tuple[Fact, ...]:
    audit = e.order_audit
    if audit is None:
        return ()
    wrong, n = audit.n_crash_wrong + audit.n_safe_wrong, audit.n_crash + audit.n_safe
    return (
        Fact(
            "Audit of the order",
            f"{wrong} of {n} contradict it",
            f"Random runs whose outcome the order implies. At {100 * audit.confidence:g} % "
            f"P(inner) is wrong by at most {percent(audit.crash_share)}, so that the probability "
            f"is at least {power_of_ten(audit.least(e.bounds))} whatever the order; and crashes "
            f"next to the outer set that the order takes as safe carry at most "
            f"{power_of_ten(audit.crash_mass_missed)}. Farther away the order was probed, and "
            "nothing is bounded.",
        ),
    )


def _traffic_ranges(e: Estimate) -> tuple[Fact, ...]:
    """Of the probability, and of what is aimed at."""
    aimed = ((f"E({c.name})", c.traffic_range) for c in e.consequences if c.aimed)
    told = [("probability", e.traffic_range), *aimed]
    return tuple(_traffic_range(what, found) for what, found in told if found is not None)


def _traffic_range(what: str, found: TrafficRange) -> Fact:
    low, middle, high = found.quantiles
    name, what = ("", "the probability") if what == "probability" else (f", {what}", what)
    return Fact(
        f"Traffic models{name}",
        f"{power_of_ten(low)} … {power_of_ten(middle)} … {power_of_ten(high)}"
        if is_number(middle)
        else "not determined",
        f"5, 50 and 95 % of {what} under {len(found.probabilities)} fits that the events allow; "
        "the answer is their mean.",
    )


def _replay(record: RunRecord) -> tuple[Fact, ...]:
    found = check_of(record)
    if found is None:
        return ()
    replay = found.replay
    crashes = f"{replay.n_crashes} crash{'' if replay.n_crashes == 1 else 'es'}"
    return (
        Fact(
            "Replay",
            f"{power_of_ten(replay.probability)} ({interval_text(replay.interval)})",
            f"{crashes} among the {replay.n_events:,} events themselves: no traffic model, and "
            f"{replay.n_simulated} more simulator runs.",
        ),
    )


def _bounds_meaning(e: Estimate) -> str:
    text = "P(inner) ≤ p ≤ P(outer), if the risk order holds"
    contradicted = Alarm.ORDER_CONTRADICTED in e.alarms
    return text + ("; here some outcomes contradict it." if contradicted else ".")


def _runs(record: RunRecord, e: Estimate) -> tuple[Fact, ...]:
    return (
        Fact("Simulator runs", count(e.n_calls), "All of them, exploration included."),
        Fact("Crashes", count(e.n_crashes), "Runs that ended in a crash."),
        Fact(
            "Failed runs",
            count(e.n_failed),
            "Runs without an outcome; counted both as crashes and as safe, never left out.",
        ),
        Fact("Stopped because", e.stop_reason.value, _asked(record)),
    )


def _asked(record: RunRecord) -> str:
    """What the target was, and the budget."""
    target = record.result.get("target")
    if not target:  # of an earlier version
        return "A campaign stops by a rule set beforehand."
    width = percent(target["relative_half_width"])
    about = target.get("aim") or f"P({record.scenario.outcome.event})"
    return f"Asked for: ± {width} of {about}, with at most {target['max_calls']:,} runs."


def _quality(e: Estimate) -> tuple[Fact, ...]:
    return (
        Fact(
            "Effective sample size",
            count(e.n_eff) if e.n_eff >= 100 else plain(e.n_eff, 3),
            "Equally weighted crashes that would be as precise. It can exceed the simulator runs: "
            "outcomes implied by the risk order, and what the fitted surrogate knows, count too.",
        ),
        Fact(
            "Largest weight share",
            percent(e.largest_weight_share) if e.probability > 0 else MISSING,
            "Share of the estimate that hangs on its most influential run; above 25 % is an alarm.",
        ),
        Fact(
            "Logarithmic efficiency",
            plain(e.log_efficiency, 3),
            "log E[Z²] / log E[Z] of one run's contribution Z: 2 at best, 1 for crude Monte Carlo.",
        ),
    )


def accelerates(e: Estimate) -> bool:
    """Whether crude Monte Carlo would need more runs."""
    return e.acceleration > 1  # NaN where there is no comparison


def _efficiency(e: Estimate) -> tuple[Fact, ...]:
    calls = e.crude_monte_carlo_calls
    return (
        Fact(
            "Crude Monte Carlo",
            f"{in_words(calls)} runs" if is_number(calls) else MISSING,
            "Random encounters needed for an interval as narrow.",
        ),
        Fact(
            "Acceleration",
            f"× {in_words(e.acceleration)}" if accelerates(e) else "none",
            "Crude Monte Carlo runs that each simulator run replaces.",
        ),
    )


def _origin(record: RunRecord, e: Estimate) -> tuple[Fact, ...]:
    versions = record.result.get("versions") or {}
    return (
        Fact("Traffic model", _traffic(record), "How often each situation occurs."),
        *_vouched(record),
        Fact(
            "Method",
            e.method,
            "“sequential”; for comparison “huang2017”, “crude”, “cross-entropy”.",
        ),
        Fact(
            "Seed",
            str(e.seed),
            "On such a processor, with scenario and traffic model, gives the same run again.",
        ),
        Fact(
            "Versions",
            ", ".join(f"{k} {v}" for k, v in versions.items()) or MISSING,
            "Of the software.",
        ),
    )


def _vouched(record: RunRecord) -> tuple[Fact, ...]:
    edits = record.result.get("vouched_sources")
    if not edits:
        return ()
    return (
        Fact(
            "Simulator edited",
            f"after {edits[-1]['n_runs']} runs",
            "Outcomes from before the edit were kept, at the user's word that they are the same.",
        ),
    )


def _traffic(record: RunRecord) -> str:
    traffic, provenance = record.traffic, record.traffic.provenance
    events = provenance.get("events") or {}
    n = len(traffic.weights)
    text = f"{n} truncated normal component{'s' if n > 1 else ''} in {', '.join(traffic.names)}"
    if traffic.members:
        text += f", and {len(traffic.members) - 1} further fits"
    if provenance.get("description"):
        text += f": {provenance['description']}"
    if not events.get("n"):
        return text
    kind = "synthetic" if record.synthetic else "recorded"
    source = f" ({events['source']})" if events.get("source") else ""
    return f"{text}, fitted to {events['n']:,} {kind} events{source}{_dropped(events)}"


def _dropped(events: Mapping[str, Any]) -> str:
    dropped = {why: n for why, n in (events.get("dropped") or {}).items() if n}
    if not dropped:
        return ""
    return "; left out: " + ", ".join(f"{n:,} ({why})" for why, n in dropped.items())
