"""The answer: the estimate that the rounds so far add up to, its interval, its alarms.

The rounds' own interval is widened where something else says that it must be: random encounters,
or too few hits, or an estimate that has not settled.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from crashrate.estimation.alarms import SHARE_LIMIT, UNDECIDED_LIMIT, Alarm, StopReason
from crashrate.estimation.carried import together
from crashrate.estimation.consequence import Consequence
from crashrate.estimation.encounters import Encounters
from crashrate.estimation.rounds import (
    MIN_ROUNDS,
    Combined,
    combine,
    counted,
    log_efficiency,
    not_refuted,
)
from crashrate.estimation.state import State
from crashrate.estimation.strategy import Problem, Snapshot
from crashrate.estimation.traffic_range import TrafficRange
from crashrate.estimation.trust import Trust, trust
from crashrate.estimation.view import View
from crashrate.estimation.within_unit import within_unit

SCATTER_LIMIT = 3.0


def answer(problem: Problem, state: State, view: View) -> Snapshot:
    """What the outcomes so far say; `view` is of the last pool."""
    bounds = view.bounds() if state.ordered else (0.0, 1.0)
    start = Snapshot(learned=state.labels.learned, bounds=bounds, phase="learn")
    rounds = state.rounds
    if state.learning:  # what is learned after rounds were estimated may refute them
        rounds = tuple(not_refuted(rounds, view.probability))
    if not rounds:
        seen = (state.encounters or Encounters()).interval(problem.confidence)
        return replace(start, interval=seen, alarms=doubts(problem, state, None, bounds))
    state = replace(state, rounds=rounds)
    c = combine(rounds, problem.confidence, state.least_inflation)
    n_runs = sum(r.n_runs for r in rounds)
    lower, upper = _with_failing(c, view)
    around = lower, max(upper, trust(problem, state, c, bounds[1]).limit)
    consequences = _consequences(problem, state, c, around)
    ranges = [c.members, *(e.traffic_range for e in consequences if e.aimed)]
    return replace(
        start,
        probability=c.estimate,
        interval=around,
        standard_error=c.standard_error,
        n_eff=(c.estimate / c.standard_error) ** 2,
        largest_weight_share=c.largest_share,
        log_efficiency=log_efficiency(c, n_runs),
        traffic_range=c.members,
        consequences=consequences,
        alarms=doubts(problem, state, c, bounds) + _open_by_models(ranges),
        phase="estimate",
        stop_reason=_stop(problem, state, c, around),
    )


def _with_failing(c: Combined, view: View) -> tuple[float, float]:
    """The rounds' interval where all that now counts as failing is safe, and where it crashes.

    Earlier rounds took some of it for safe: it was not known that runs fail there.
    """
    failing = np.where(view.failing, view.weights, 0.0)
    least, most = c.estimate - float(failing @ view.h), c.estimate + float(failing @ (1 - view.h))
    found = within_unit(c.estimate, c.half_width, least, most)
    return min(c.lower, found.lower), max(c.upper, found.upper)


def first_idea(problem: Problem, state: State, view: View) -> Snapshot:
    """What rounds say before a surprise, where the budget left none to follow them.

    Their estimate is wrong by an amount that nobody knows: the interval is what the order and
    random encounters leave. Nothing is said where these exclude it.
    """
    bounds = view.bounds() if state.ordered else (0.0, 1.0)
    c = combine(state.rounds, problem.confidence, state.least_inflation)
    inner, outer = (0.0, 1.0) if state.labels.contradictions else bounds
    met = state.encounters or Encounters()
    if met.speak_against(c.upper):
        return answer(problem, replace(state, rounds=()), view)
    upper = max(c.upper, min(outer, met.interval(problem.confidence)[1]))
    return Snapshot(
        learned=state.labels.learned,
        bounds=bounds,
        probability=c.estimate,
        interval=(min(inner, c.lower), upper),
        alarms=(*doubts(problem, state, None, bounds), Alarm.UNSETTLED),
        phase="learn",
    )


def _consequences(
    problem: Problem, state: State, c: Combined, event: tuple[float, float]
) -> tuple[Consequence, ...]:
    """Each consequence, where `c` and the interval `event` are found for the event."""
    found = tuple(
        together(
            name,
            [r.consequences[k] for r in counted(state.rounds)],
            int(np.count_nonzero(state.labels.z[:, k] > 0)),
            event,
            problem.confidence,
            total=float(np.nansum(state.labels.z[:, k])),
            least=state.least_inflation,
            aimed=name == problem.aim,
        )
        for k, name in enumerate(problem.consequences)
    )
    if event[1] <= c.upper:
        return found
    # what widens the event's interval says no more of consequences
    return tuple(replace(f, interval=(f.interval[0], event[1])) for f in found)


def _stop(problem: Problem, state: State, c: Combined, event: tuple[float, float]) -> StopReason:
    aimed = _target(problem, state, c, event)
    if min(c.n_rounds, state.n_since) >= MIN_ROUNDS and narrow(problem, state, *aimed):
        return StopReason.TARGET_MET
    return StopReason.RUNNING


def _target(
    problem: Problem, state: State, c: Combined, event: tuple[float, float]
) -> tuple[float, tuple[float, float]]:
    """The estimate that is aimed at and the interval around it: the event's, or a consequence's."""
    if (k := problem.aim_index) is None:
        return c.estimate, event
    aimed = _consequences(problem, state, c, event)[k]
    return aimed.mean, aimed.interval


def narrow(problem: Problem, state: State, estimate: float, around: tuple[float, float]) -> bool:
    """Whether the interval `around` the estimate meets the target in force."""
    half = (around[1] - around[0]) / 2
    return bool(estimate > 0 and half <= problem.target_at(state.labels.n) * estimate)


def doubts(
    problem: Problem, state: State, c: Combined | None, bounds: tuple[float, float]
) -> tuple[Alarm, ...]:
    """Alarms on the rounds' estimate, if there is one, and on what it rests on."""
    trusted = Trust() if c is None else trust(problem, state, c, bounds[1])
    raised = {
        Alarm.ORDER_DROPPED: state.dropped_at is not None,
        Alarm.LEFT_OUT_MATTERS: problem.order is not None and state.labels.order is None,
        Alarm.LEFT_OUT_UNTESTED: (problem.blind is not None and state.ordered and not state.tested),
        Alarm.ORDER_CONTRADICTED: state.labels.contradictions > 0,
        Alarm.NO_ORDER: problem.order is None or not state.ordered,
        Alarm.ENCOUNTERS_DISAGREE: trusted.outvoted,
        Alarm.TOO_FEW_CRASHES: trusted.few,
        Alarm.UNSETTLED: trusted.unsettled,
        Alarm.OUTCOMES_UNFORESEEN: state.surprised,
        Alarm.SCATTER_BEYOND_PREDICTION: c is not None and c.scatter > SCATTER_LIMIT,
        Alarm.WEIGHTS_CONCENTRATED: c is not None and c.largest_share > SHARE_LIMIT,
        Alarm.UNDECIDED_MASS_LARGE: (
            c is not None and state.ordered and bounds[1] > UNDECIDED_LIMIT * c.estimate
        ),
    }
    return tuple(alarm for alarm, is_raised in raised.items() if is_raised)


def _open_by_models(ranges: Iterable[TrafficRange | None]) -> tuple[Alarm, ...]:
    """What the traffic models leave open of the probability, and of what is aimed at."""
    told = [r for r in ranges if r is not None]
    raised = {
        Alarm.TRAFFIC_UNDETERMINED: any(r.undetermined for r in told),
        Alarm.MEMBERS_UNDETERMINED: any(r.n_undetermined > 0 for r in told),
    }
    return tuple(alarm for alarm, is_raised in raised.items() if is_raised)


def outvoted(problem: Problem, state: State) -> bool:
    """Whether the encounters alone keep the rounds' estimate from its target."""
    if state.encounters is None or len(state.rounds) < MIN_ROUNDS:
        return False
    c = combine(state.rounds, problem.confidence, state.least_inflation)
    met = narrow(problem, state, *_target(problem, state, c, (c.lower, c.upper)))
    return met and state.encounters.speak_against(c.upper)
