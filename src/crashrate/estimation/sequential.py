"""The default method: learn the crash set with a surrogate, estimate without trusting it.

Rounds of a few simulator runs. Each draws a cheap pool, looks at it through the surrogate and the
risk order, and chooses runs from it: to learn, while one round could not estimate well; to
estimate, after. docs/method.md has the reasons.
"""

import math
from collections.abc import Generator
from dataclasses import replace

import numpy as np

from crashrate.crash_set.surrogate import Surrogate
from crashrate.estimation.aiming import aim
from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.estimation.answer import answer, doubts, first_idea, narrow, outvoted
from crashrate.estimation.beginning import N_POOL, begin, by_variables
from crashrate.estimation.belief import Belief
from crashrate.estimation.carried import carry
from crashrate.estimation.consequences import expect
from crashrate.estimation.crude import crude
from crashrate.estimation.direction import MAX_ROUNDS, towards, unclear
from crashrate.estimation.encounters import Encounters, meet
from crashrate.estimation.exact_bounds import exact_bounds, within
from crashrate.estimation.exploration import explore, ordinary_is_safe
from crashrate.estimation.following import look_closer
from crashrate.estimation.hindsight import design
from crashrate.estimation.kernels import Model
from crashrate.estimation.labels import Labels
from crashrate.estimation.last_look import SURVEYS, last_look, left_out, surveyed
from crashrate.estimation.leaving_out import check_contradicted
from crashrate.estimation.probing import ask, vouched_safe
from crashrate.estimation.readiness import foreseeing, ready
from crashrate.estimation.refutation import Verdict, verdict
from crashrate.estimation.rounds import Round, measure
from crashrate.estimation.selection import IntArray, aside, audit, to_estimate, to_learn
from crashrate.estimation.sizing import (
    AUDIT_EVERY,
    audits_due,
    last,
    size,
    size_to_learn,
)
from crashrate.estimation.state import State
from crashrate.estimation.strategy import Problem, Query, Snapshot
from crashrate.estimation.surveying import MAX_SURVEYS, first_survey
from crashrate.estimation.view import Standardiser, View, see
from crashrate.sampling.pool import Density, draw_pool
from crashrate.variables import FloatArray

# random streams beside those of the rounds
ENCOUNTERS, MORE, FOLLOWING = 2_000_001, 3_000_000, 4_000_000
N_LINES = 2  # two more than variables taught less of the edge than the rounds they would pay for
ASIDE_SHARE = 0.4  # of an estimating round, for learning and audits
# Contradicted outcomes, and their share of all, at which an order that leaves something out goes:
# a few low crashes may account for all of them.
MANY_ODD, ODD_SHARE = 20, 1 / 3
Learner = Generator[Query, FloatArray, Snapshot]


def sequential(problem: Problem) -> Learner:
    """Run the default method; see the module."""
    explored = yield from explore(problem, N_LINES)
    if not explored.found:
        found = yield from crude(problem, explored.labels)
        if isinstance(found, Snapshot):
            return found
        explored = replace(explored, labels=found, ordinary=explored.ordinary[:0])
    state, view = begin(problem, explored), None
    alarms = doubts(problem, state, None, (0.0, 1.0))
    snapshot = Snapshot(learned=state.labels.learned, alarms=alarms)
    while state.labels.n < problem.max_calls:
        if not state.ordered and state.encounters is None:
            labels, met = yield from meet(problem, state.labels, problem.rng(ENCOUNTERS))
            rng = problem.rng(SURVEYS)
            labels = yield from first_survey(problem, labels, explored.n_filling, rng)
            state = replace(state, labels=labels, encounters=met, ordinary=state.ordinary[:0])
            continue
        state, view = yield from _round(problem, state, snapshot)
        rng = problem.rng(FOLLOWING + state.k)
        closer = yield from look_closer(problem, state, view, snapshot, rng)
        state = state if closer is state else _distrust(problem, closer, view)
        state = yield from _tested_early(problem, state, snapshot)
        snapshot = answer(problem, state, view)
        if snapshot.stop_reason is not StopReason.RUNNING:
            state, view, snapshot = yield from _checked(problem, state, view)
        if outvoted(problem, state):
            # one crash among thirty encounters may be bad luck, or what the surrogate never saw:
            # more encounters tell, more rounds do not
            rng = problem.rng(MORE + state.k)
            labels, met = yield from meet(problem, state.labels, rng, snapshot)
            seen = (state.encounters or Encounters()) + met
            state = replace(state, labels=labels, encounters=seen)
            snapshot = answer(problem, state, view)
        state = _directed(problem, state, snapshot)
        reached = snapshot.stop_reason is not StopReason.RUNNING
        if reached and surveyed(problem, state) and not state.members:
            bounded = _bounded(problem, state, snapshot)
            if bounded.stop_reason is not StopReason.RUNNING:
                return replace(bounded, belief=_belief(state))
        snapshot = replace(snapshot, stop_reason=StopReason.RUNNING)
    return replace(_last_word(problem, state, view, snapshot), belief=_belief(state))


def _tested_early(
    problem: Problem, state: State, snapshot: Snapshot
) -> Generator[Query, FloatArray, State]:
    """Where outcomes contradict an order what it does not see may be why: that is tested at once.

    Its coordinates leave such outcomes random, and the target may be far.
    """
    if problem.blind is None or state.tested or not (state.ordered and state.labels.contradictions):
        return state
    return (yield from left_out(problem, state, snapshot))[0]


def _checked(
    problem: Problem, state: State, view: View
) -> Generator[Query, FloatArray, tuple[State, View, Snapshot]]:
    """An answer that may stand: the last outcomes have their say first, and a last look."""
    fitted = state.fit()
    state = state.reconsidered(*fitted)
    snapshot = answer(problem, state, view)
    if snapshot.stop_reason is StopReason.RUNNING or surveyed(problem, state):
        return state, view, snapshot
    state = yield from last_look(problem, state, snapshot, *fitted)
    # where runs fail is known from the last ones too
    view = view if state.labels.known.all() else _again(state, view, *state.fit())
    snapshot = answer(problem, state, view)
    if snapshot.stop_reason is StopReason.RUNNING and state.n_surveys < MAX_SURVEYS:
        state = replace(state, surveyed_for=math.inf)
    return state, view, snapshot


def _bounded(problem: Problem, state: State, snapshot: Snapshot) -> Snapshot:
    """With exact bounds, where they can be had; not at an end where they widen it too far."""
    exact = exact_bounds(problem, state.labels)
    if exact is None:
        return snapshot
    told = snapshot if state.labels.contradictions else within(snapshot, exact)
    widened = told.interval != snapshot.interval and problem.aim_index is None
    if widened and not narrow(problem, state, told.probability, told.interval):
        reason = snapshot.stop_reason
        running = reason is StopReason.TARGET_MET
        told = replace(told, stop_reason=StopReason.RUNNING if running else reason)
    return replace(told, bounds=exact)


def _last_word(problem: Problem, state: State, view: View | None, snapshot: Snapshot) -> Snapshot:
    """What an ended budget leaves; the last outcomes have their say."""
    if view is not None:
        surrogate, model = state.fit()
        # what was held of the last pool before may have been the mistake
        view = _again(state, view, surrogate, model)
        snapshot = answer(problem, state.reconsidered(surrogate, model), view)
        if state.shaken and not state.n_since:
            shaken = replace(state, rounds=state.shaken)
            snapshot = first_idea(problem, shaken.reconsidered(surrogate, model), view)
    snapshot = _bounded(problem, state, snapshot)
    if snapshot.stop_reason is StopReason.TARGET_MET:
        snapshot = replace(snapshot, alarms=(*snapshot.alarms, Alarm.TARGET_UNCHECKED))
    return replace(snapshot, stop_reason=StopReason.BUDGET_ENDED)


def _again(state: State, view: View, surrogate: Surrogate, model: Model) -> View:
    """The pool as it is seen now."""
    pool = replace(view.pool, u=state.labels.coordinates(view.pool.x))  # they may be others by now
    return see(pool, state.labels, surrogate, model.standardise)


def _belief(state: State) -> Belief:
    """What all outcomes say, the last round's included."""
    surrogate, model = state.fit()
    return Belief(state.labels, surrogate, model.standardise, state.proposal)


def _directed(problem: Problem, state: State, snapshot: Snapshot) -> State:
    """With the members that the next round looks at: after the target is met, a few times."""
    # cut, it would be no round
    whole = problem.max_calls - state.labels.n >= size(problem, state)
    if snapshot.stop_reason is StopReason.RUNNING or not whole or state.n_directed == MAX_ROUNDS:
        return replace(state, members=())
    k = problem.aim_index
    aimed = snapshot if k is None else snapshot.consequences[k]
    members = unclear(aimed.traffic_range)
    return replace(state, members=members, n_directed=state.n_directed + 1)


def _round(
    problem: Problem, state: State, snapshot: Snapshot
) -> Generator[Query, FloatArray, tuple[State, View]]:
    """One round: see a fresh pool, choose runs from it, learn their outcomes."""
    rng = problem.rng(state.k)
    surrogate, model = state.fit()
    state = state.reconsidered(surrogate, model)
    proposal = state.proposal
    # the first proposal is only inflated traffic, and the last round's was not for these members
    for _ in range(2 if state.k == 1 else bool(state.members)):
        proposal = _aim(problem, state, _see(problem, state, surrogate, proposal, rng), rng)
    view = _see(problem, state, surrogate, proposal, rng)
    wanted = towards(view, state.members)
    state = foreseeing(state, wanted, view.probability)
    learning = state.may_learn and not ready(problem, state)
    if learning:
        n = size_to_learn(problem, state)
        audits = _audits(problem, state, wanted, n, rng)
        rows = to_learn(wanted, n, audits, rng)
        snapshot = replace(snapshot, phase="learn")
        labels = yield from ask(problem, state.labels, view.pool.x[rows], snapshot)
        rounds = state.rounds
    else:
        labels, rounds = yield from _estimate(problem, state, view, snapshot, rng)
    unit = model.standardise.unit
    labels = yield from check_contradicted(problem, labels, unit, snapshot)
    free = not state.directed
    seen = Standardiser.weighted(view.pool.u, view.learning, view.breadth, free=free)
    standardise = model.standardise.or_else(seen)
    state = replace(
        state,
        labels=labels,
        rounds=rounds,
        model=replace(model, standardise=standardise),
        proposal=_aim(problem, state, view, rng),
        k=state.k + 1,
        learning=learning,
    )
    return _distrust(problem, state, view), view


def _audits(
    problem: Problem, state: State, view: View, n: int, rng: np.random.Generator
) -> IntArray:
    """Those of a round's `n` runs where the order knows the outcome: among crashes, and far off."""
    among = audit(view, audits_due(problem, state, n), rng)
    far = audits_due(problem, state, n, shift=AUDIT_EVERY // 2)
    return np.concatenate([among, vouched_safe(problem, state.labels, view.pool, far)])


def _see(
    problem: Problem,
    state: State,
    surrogate: Surrogate,
    proposal: Density,
    rng: np.random.Generator,
) -> View:
    coordinates = state.labels.coordinates
    pool = draw_pool(proposal, problem.traffic, coordinates, N_POOL, rng, ensemble=problem.ensemble)
    view = see(pool, state.labels, surrogate, state.model.standardise)
    target = problem.target_at(state.labels.n)
    view = replace(view, neglected=state.neglected(target))
    if not problem.consequences:
        return view
    found = expect(view, state.labels, surrogate, state.model.standardise)
    return replace(view, consequences=found, aim=problem.aim_index)


def _aim(problem: Problem, state: State, view: View, rng: np.random.Generator) -> Density:
    """Where the next pool is drawn: for the average, and for the members looked at."""
    views = (view, towards(view, state.members)) if state.members else (view,)
    return aim(problem.traffic, views, rng)


def _estimate(
    problem: Problem, state: State, view: View, snapshot: Snapshot, rng: np.random.Generator
) -> Generator[Query, FloatArray, tuple[Labels, tuple[Round, ...]]]:
    """Runs drawn with known probabilities, and a few that settle much through the order."""
    wanted = towards(view, state.members)
    n_last = last(problem, state, view)
    n = n_last or size(problem, state)
    n_aside = round(ASIDE_SHARE * n) if state.ordered and n_last is None else 0
    # what is audited in a last round could change no later one
    audits = _audits(problem, state, wanted, n if n_last is None else 0, rng)
    others = aside(wanted, n_aside, audits, rng)
    drawn = to_estimate(view, n - len(others), rng, wanted if state.members else None)
    rows = np.unique(np.concatenate([drawn.rows, others]))
    room = problem.max_calls - state.labels.n
    if len(rows) > room:  # a cut batch is no unbiased round: its runs are spent on learning
        labels = yield from ask(problem, state.labels, view.pool.x[rows[:room]], snapshot)
        return labels, state.rounds
    snapshot = replace(snapshot, phase="estimate")
    labels = yield from ask(problem, state.labels, view.pool.x[rows], snapshot)
    told = labels.n - len(rows) + np.searchsorted(rows, drawn.rows)
    found = replace(measure(view, drawn, labels.y[told]), design=design(view, drawn))
    if problem.consequences:
        found = replace(found, consequences=carry(view, drawn, labels.y[told], labels.z[told]))
    return labels, (*state.rounds, found)


def _is_odd(labels: Labels) -> bool:
    """Whether so many outcomes contradict the order that few others could be what is odd."""
    return labels.contradictions > max(MANY_ODD, ODD_SHARE * labels.n)


def _distrust(problem: Problem, state: State, view: View) -> State:
    """Drop assumptions that the outcomes speak against."""
    found = verdict(state.labels, state.model.standardise.unit)
    given_up = problem.order is not None and state.labels.order is None and state.directed
    fails = found is not Verdict.STANDS or _is_odd(state.labels)
    if given_up or (fails and problem.blind is not None):  # what it does not see may be why
        return by_variables(problem, state, state.labels.by_variables())
    if found is not Verdict.STANDS:
        return replace(
            state,
            labels=state.labels.without_order(),
            rounds=(),
            shaken=(),
            directed=found is not Verdict.FALSE,
            dropped_at=state.labels.n,
            foreseen=(),
            surveyed_for=math.inf,
            surprised=False,
            model=state.model.forgetting(),
        )
    if len(state.ordinary) and not ordinary_is_safe(view.probability):
        return replace(state, ordinary=state.ordinary[:0], model=state.model.forgetting())
    return state
