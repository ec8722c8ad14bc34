"""The last look before an answer stands: what the order leaves out, and where no run came near."""

import math
from collections.abc import Generator
from dataclasses import replace

from crashrate.crash_set.surrogate import Surrogate
from crashrate.estimation.alarms import StopReason
from crashrate.estimation.beginning import by_variables
from crashrate.estimation.belief import Belief
from crashrate.estimation.kernels import Model
from crashrate.estimation.leaving_out import check_left_out
from crashrate.estimation.state import State
from crashrate.estimation.strategy import Problem, Query, Snapshot
from crashrate.estimation.surveying import MAX_SURVEYS, survey
from crashrate.variables import FloatArray

# random streams beside those of the rounds
SURVEYS, LEFT_OUT = 2_000_002, 5_000_000


def last_look(
    problem: Problem, state: State, snapshot: Snapshot, surrogate: Surrogate, model: Model
) -> Generator[Query, FloatArray, State]:
    """Look once more before the answer stands: first at what the order leaves out."""
    if state.n_surveys < MAX_SURVEYS:
        running = replace(snapshot, stop_reason=StopReason.RUNNING)
        tested, whole = yield from left_out(problem, state, running)
        before, now = state.labels, tested.labels
        if not whole or now.order is not before.order or now.contradictions > before.contradictions:
            return tested  # with rounds to come, if the budget leaves any
        state = tested
    return (yield from _survey(problem, state, snapshot, surrogate, model))


def left_out(
    problem: Problem, state: State, snapshot: Snapshot
) -> Generator[Query, FloatArray, tuple[State, bool]]:
    """See whether a variable that the order leaves out matters, and if so begin anew by variables.

    And whether the budget let it look everywhere.
    """
    unit, rng = state.model.standardise.unit, problem.rng(LEFT_OUT + state.k)
    labels, whole = yield from check_left_out(problem, state.labels, unit, rng, snapshot)
    if labels.order is not state.labels.order:
        return by_variables(problem, state, labels), whole
    contradicted = labels.contradictions > state.labels.contradictions
    n_surveys = state.n_surveys + contradicted  # another look comes, as after a surprise
    tested = state.tested or (whole and labels.n > state.labels.n)
    return replace(state, labels=labels, n_surveys=n_surveys, tested=tested), whole


def _survey(
    problem: Problem, state: State, snapshot: Snapshot, surrogate: Surrogate, model: Model
) -> Generator[Query, FloatArray, State]:
    """Look at places that no run came near; after a surprise there it is learned anew."""
    rng, target = problem.rng(SURVEYS + 1 + state.n_surveys), problem.target_at(state.labels.n)
    running = replace(snapshot, stop_reason=StopReason.RUNNING)
    belief = Belief(state.labels, surrogate, model.standardise, state.proposal)

    def rivals() -> tuple[Surrogate, ...]:
        return model.rivals(state.labels, state.ordinary, directed=state.directed)

    look = yield from survey(problem, belief, rivals, running, rng)
    done = state.n_surveys + 1
    state = replace(state, labels=look.labels, n_surveys=done, surprised=look.surprised)
    ended = look.whole and (not look.surprised or done >= MAX_SURVEYS)
    if ended or look.surprised:
        state = replace(state, surveyed_for=target if ended else math.inf)
    if look.surprised:
        state = _shaken(state)
    doubted = state.rounds and (look.surprised or look.doubted)
    return state.reconsidered(*state.fit()) if doubted else state


def _shaken(state: State) -> State:
    """After a surprise: what was believed is learned anew.

    With an order the rounds stay, for what they are worth by what is known then. Without one the
    surrogate alone would say that, which has just been wrong: they are void.
    """
    model, n = state.model.forgetting(), state.labels.n
    state = replace(state, foreseen=(), shaken=state.rounds, shaken_at=n, model=model)
    return state if state.ordered else replace(state, rounds=(), n_directed=0)


def surveyed(problem: Problem, state: State) -> bool:
    """Whether the last look was for the target in force."""
    return state.surveyed_for <= problem.target_at(state.labels.n)
