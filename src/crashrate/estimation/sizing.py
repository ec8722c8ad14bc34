"""How many runs a round has."""

import math

import numpy as np

from crashrate.estimation.rounds import MIN_ROUNDS, TINY, combine, draws_to, predicted_variance
from crashrate.estimation.selection import estimating
from crashrate.estimation.state import State
from crashrate.estimation.strategy import Problem
from crashrate.estimation.view import View

ROUND = 10
LATEST = 5  # rounds that tell how fast one draw's variance falls
FEWEST = ROUND  # draws of the last round: to look more often is to stop at the first lucky look


def size(problem: Problem, state: State) -> int:
    """Runs of the next round: a batch; large ones are grown into.

    A thousand runs chosen by what forty taught would be spent at once. The budget has no say: what
    is asked for first must not depend on how much may come after.
    """
    return min(problem.batch_size, max(ROUND, state.labels.n // 2))


def learning_pays(problem: Problem, state: State, view: View, share: float) -> bool:
    """Whether `share` of each round spent on learning brings the target nearer.

    Rounds of n draws with the variance s² each need r = M s² / n of them for a missing precision M;
    where every round leaves s² at g s², those of (1 - share) n draws add up to M after
    log(1 + M s² / ((1 - share) n) (1/g - 1)) / log(1/g). At the ripples of a rough edge nothing is
    left to learn, and g is 1; near the target nothing learned would still be of use.
    """
    if _elsewhere(problem, state) or len(state.rounds) < MIN_ROUNDS - 1:
        return True
    per_draw = predicted_variance(view, estimating(view), 1)
    falls = _falls(state, per_draw / max(view.probability, TINY) ** 2)
    so_far = combine(state.rounds, problem.confidence)
    target = problem.target_at(state.labels.n)
    rounds = draws_to(target, so_far, per_draw, 0.0, problem.confidence) / size(problem, state)
    if math.isinf(rounds):
        return True
    return falls > 0 and math.log1p(rounds / (1 - share) * math.expm1(falls)) / falls < rounds


def _falls(state: State, latest: float) -> float:
    """How much the logarithm of one draw's relative variance falls in a round."""
    rounds = state.rounds[1 - LATEST :]
    seen = [*(r.variance * r.n_draws / max(r.predicted, TINY) ** 2 for r in rounds), latest]
    return float(-np.polyfit(np.arange(len(seen)), np.log(seen), 1)[0])


def last(problem: Problem, state: State, view: View) -> int | None:
    """Draws of the next round if it is likely to be the last; None if it is not.

    Nothing need be put aside for later rounds then, nor more be drawn than the target asks for. The
    number follows from the past and the pool: the round stays unbiased.
    """
    if _elsewhere(problem, state) or len(state.rounds) < MIN_ROUNDS - 1:
        return None
    per_draw, of_pool = predicted_variance(view, estimating(view), 1), view.pool_variance
    so_far = combine(state.rounds, problem.confidence)
    target = problem.target_at(state.labels.n)
    n = max(draws_to(target, so_far, per_draw, of_pool, problem.confidence), FEWEST)
    return math.ceil(n) if n <= size(problem, state) else None


def _elsewhere(problem: Problem, state: State) -> bool:
    """Whether something else than the event under the average decides where the campaign ends."""
    return bool(state.members) or problem.aim_index is not None
