"""Goal "bounds": runs that close the bracket P(inner) ≤ p ≤ P(outer), and audit the order under it.

After the exploration each round asks for the situations whose outcomes are expected to shrink
log P(outer) / P(inner) most. The surrogate says where the crash set's edge may be; nothing else
rests on it. The last tenth of the runs audits the order. In m risk coordinates n runs leave about
n^(-1 / (m - 1)) of the gap, wherever they are put.
"""

from collections.abc import Generator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from crashrate.crash_set.surrogate import Surrogate
from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.estimation.auditing import audit_order
from crashrate.estimation.belief import Belief
from crashrate.estimation.crude import crude
from crashrate.estimation.exact_bounds import exact_bounds
from crashrate.estimation.exploration import Explored, explore, ordinary_is_safe
from crashrate.estimation.gap import Gap, aim_at_gap, candidates, closest, look
from crashrate.estimation.kernels import Model
from crashrate.estimation.labels import Labels
from crashrate.estimation.leaving_out import check_left_out, most_runs
from crashrate.estimation.order_audit import OrderAudit
from crashrate.estimation.refutation import Verdict, verdict
from crashrate.estimation.strategy import Problem, Query, Snapshot
from crashrate.estimation.view import UNSURE, UNSURE_OF_CRASH, Standardiser, normalised
from crashrate.sampling.pool import Density, draw_pool
from crashrate.variables import BoolArray, FloatArray

# random streams beside those of the rounds
BEGINNING, AUDITS, LAST = 4_000_000, 4_000_001, 5_000_000
N_POOL = 40_000
N_LAST = 100_000  # draws for the last bounds where they are not exact
AUDITED, MAX_AUDITS = 0.1, 60  # share of the runs that audits the order, and the most
Bracketing = Generator[Query, FloatArray, Snapshot]


@dataclass(frozen=True)
class State:
    """Everything a round starts from.

    Parameters
    ----------
    labels : Labels
    ordinary : ndarray, shape (n, m)
        Risk coordinates of traffic's draws that the surrogate takes as safe.
    proposal : Density
        Of the next pool.
    model : Model
    k : int
        Number of the round.
    over : StopReason
        Why there is nothing more to close, or that there is.
    audit : OrderAudit or None
        The last one.
    audited_at : int
        The round before which it was.
    tested : bool
        Whether what the order does not see was, as far as it is.
    """

    labels: Labels
    ordinary: FloatArray
    proposal: Density
    model: Model
    k: int = 1
    over: StopReason = StopReason.RUNNING
    audit: OrderAudit | None = None
    audited_at: int = 0
    tested: bool = False


def bracket(problem: Problem) -> Bracketing:
    """Run it; see the module. The problem has an order."""
    explored = yield from _explore(problem)
    if explored is None:
        return _dropped(problem)
    if not explored.found:
        found = yield from crude(problem, explored.labels)
        if isinstance(found, Snapshot):
            return replace(found, bounds=exact_bounds(problem, explored.labels) or (0.0, 1.0))
        explored = replace(explored, labels=found, ordinary=explored.ordinary[:0])
    state = _begin(problem, explored)
    reason = StopReason.RUNNING
    while reason is StopReason.RUNNING:  # more than once where an earlier call had ended sooner
        state = yield from _close(problem, replace(state, over=reason))
        state = yield from _audit(problem, state)
        if _refuted(state):
            return _dropped(problem)
        reason = _reason(problem, state)
    return _end(problem, state, reason)


def _explore(problem: Problem) -> Generator[Query, FloatArray, Explored | None]:
    """Explore, along more lines than an estimate pays for; None once the order is dropped."""
    # the edge is all that bounds need
    steps, outcomes = explore(problem, 2 + problem.traffic.n_variables), None
    try:
        while True:
            query = next(steps) if outcomes is None else steps.send(outcomes)
            if query.snapshot.learned is None:
                return None
            outcomes = yield query
    except StopIteration as end:
        found: Explored = end.value
        return found if found.labels.learned is not None else None


def _begin(problem: Problem, explored: Explored) -> State:
    rng = problem.rng(BEGINNING)
    ordinary = explored.most_dangerous(rng)
    x = explored.wide.sample(N_POOL, rng)
    u = explored.labels.coordinates(x[problem.traffic.contains(x)])
    standardise = Standardiser.weighted(u, np.full(len(u), 1 / len(u)))
    return State(explored.labels, ordinary, explored.wide, Model(standardise))


# --- closing


def _close(problem: Problem, state: State) -> Generator[Query, FloatArray, State]:
    """Rounds until the bracket is as close as wanted, or the audit's turn has come."""
    while (room := _room(problem, state)) > 0 and state.over is StopReason.RUNNING:
        state, gap = yield from _round(problem, state, room)
        if _refuted(state):
            break
        near = _meets(problem, state, (gap.inner, gap.outer))
        if near and _meets(problem, state, _bounds(problem, state)):
            return replace(state, over=StopReason.TARGET_MET)
    return state


def _room(problem: Problem, state: State) -> int:
    """Runs that may still go into closing: the others of the budget in force audit the order."""
    n = state.labels.n
    budget = problem.budget_at(n)
    tests = 0 if state.tested else min(most_runs(problem), budget // 2)
    return budget - min(MAX_AUDITS, round(AUDITED * budget)) - tests - n


def _round(
    problem: Problem, state: State, room: int
) -> Generator[Query, FloatArray, tuple[State, Gap]]:
    """See a fresh pool, simulate what closes the gap most."""
    labels, rng = state.labels, problem.rng(state.k)
    surrogate, model = state.model.fit(labels, state.ordinary, directed=True)

    def held(u: FloatArray) -> FloatArray:
        return _held(surrogate, model.standardise, u)

    proposal = state.proposal
    for last in (False, False, True) if state.k == 1 else (True,):  # the first is inflated traffic
        gap = _see(problem, labels, proposal, N_POOL, rng)
        if not len(gap.undecided):
            return replace(state, over=StopReason.ALL_DECIDED), gap
        seen = look(gap, held, rng)
        aimed = aim_at_gap(gap, seen, problem.traffic, rng)
        proposal = proposal if last else aimed
    among = candidates(gap, seen, problem.traffic, labels, held=held, rng=rng)
    among = among.where(~_near_a_failure(labels, among.u, model.standardise))
    x = closest(gap, among, min(problem.batch_size, room), rng)
    if not len(x):
        return replace(state, over=StopReason.ALL_DECIDED), gap
    y = yield Query(x, _standing(labels, gap.bounds()))
    edge = Standardiser.weighted(gap.pool.u[seen.even], normalised(seen.h_even * (1 - seen.h_even)))
    model = replace(model, standardise=model.standardise.or_else(edge))
    ordinary = state.ordinary if ordinary_is_safe(gap.inner) else state.ordinary[:0]
    if len(ordinary) < len(state.ordinary):
        model = model.forgetting()
    return (
        replace(
            state,
            labels=labels.add(x, y),
            ordinary=ordinary,
            proposal=aimed,
            model=model,
            k=state.k + 1,
        ),
        gap,
    )


def _held(surrogate: Surrogate, standardise: Standardiser, u: FloatArray) -> FloatArray:
    if not len(u):
        return np.empty(0)
    return np.clip(surrogate.predict(standardise(u)).probability, UNSURE, 1 - UNSURE_OF_CRASH)


def _see(
    problem: Problem, labels: Labels, proposal: Density, n: int, rng: np.random.Generator
) -> Gap:
    return Gap.of(draw_pool(proposal, problem.traffic, labels.coordinates, n, rng), labels)


def _near_a_failure(labels: Labels, u: FloatArray, standardise: Standardiser) -> BoolArray:
    """Which of `u` (n, m) have a failed simulation as the nearest run.

    A failure decides nothing, and the greatest gain would be beside it again.
    """
    if labels.known.all():
        return np.zeros(len(u), dtype=np.bool_)
    nearest = cKDTree(standardise(labels.u)).query(standardise(u))[1]
    return np.asarray(~labels.known[nearest])


def _standing(labels: Labels, bounds: tuple[float, float]) -> Snapshot:
    return Snapshot(bounds=bounds, alarms=_alarms(labels), learned=labels.learned, phase="close")


def _alarms(labels: Labels) -> tuple[Alarm, ...]:
    return (Alarm.ORDER_CONTRADICTED,) if labels.contradictions else ()


# --- the order


def _audit(problem: Problem, state: State) -> Generator[Query, FloatArray, State]:
    """Audit the order with a tenth of the runs, those before and these."""
    labels, n = state.labels, state.labels.n
    share = max(round(n * AUDITED / (1 - AUDITED)), 1)
    room = problem.budget_at(n) - n
    if _refuted(state) or room < 1 or state.audited_at == state.k:
        return state
    rng = problem.rng(AUDITS + state.k)
    snapshot = replace(_standing(labels, _bounds(problem, state)), phase="audit")
    scale = state.model.standardise.unit
    in_force = replace(problem, max_calls=problem.budget_at(n))
    if not state.tested:
        labels, whole = yield from check_left_out(in_force, labels, scale, rng, snapshot)
        state = replace(state, tested=whole and labels.n > n)
    n_runs = min(MAX_AUDITS, share, room - (labels.n - n))
    if labels.learned is None or n_runs < 1:
        return replace(state, labels=labels)
    labels, audit = yield from audit_order(
        problem, state.proposal, labels, scale, n_runs, rng=rng, snapshot=snapshot
    )
    return replace(state, labels=labels, audit=audit, audited_at=state.k)


def _refuted(state: State) -> bool:
    """Whether the outcomes contradict the order as much as makes an estimate drop it."""
    if state.labels.learned is None:
        return True
    return verdict(state.labels, state.model.standardise.unit) is not Verdict.STANDS


def _dropped(problem: Problem) -> Snapshot:
    left_out = (Alarm.LEFT_OUT_MATTERS,) if problem.blind is not None else ()
    return Snapshot(
        alarms=(Alarm.ORDER_DROPPED, *left_out, Alarm.NO_ORDER),
        phase="close",
        stop_reason=StopReason.ORDER_DROPPED,
    )


# --- the end


def _meets(problem: Problem, state: State, bounds: tuple[float, float]) -> bool:
    """Whether half the bracket over its middle is at most the target in force."""
    inner, outer = bounds
    return inner > 0 and outer - inner <= problem.target_at(state.labels.n) * (outer + inner)


def _bounds(problem: Problem, state: State) -> tuple[float, float]:
    """Exact, or else of many draws, two standard errors to the safe side."""
    exact = exact_bounds(problem, state.labels)
    if exact is not None:
        return exact
    rng = problem.rng(LAST + state.k)
    return _see(problem, state.labels, state.proposal, N_LAST, rng).bounds()


def _reason(problem: Problem, state: State) -> StopReason:
    """Why it ends, or RUNNING where target or budget are others now than when it was audited."""
    if _meets(problem, state, _bounds(problem, state)):
        return StopReason.TARGET_MET
    if state.over is StopReason.ALL_DECIDED:
        return state.over
    return StopReason.RUNNING if _room(problem, state) > 0 else StopReason.BUDGET_ENDED


def _end(problem: Problem, state: State, reason: StopReason) -> Snapshot:
    labels = state.labels
    untested = problem.blind is not None and not state.tested
    surrogate, model = state.model.fit(labels, state.ordinary, directed=True)
    return Snapshot(
        bounds=_bounds(problem, state),
        alarms=_alarms(labels) + (Alarm.LEFT_OUT_UNTESTED,) * untested,
        order_audit=state.audit,
        learned=labels.learned,
        belief=Belief(labels, surrogate, model.standardise, state.proposal),
        phase="audit",
        stop_reason=reason,
    )
