"""How many runs a round has."""

import math

from crashrate.estimation.rounds import MIN_ROUNDS, combine, draws_to, predicted_variance
from crashrate.estimation.selection import estimating
from crashrate.estimation.state import State
from crashrate.estimation.strategy import Problem
from crashrate.estimation.trust import trust
from crashrate.estimation.view import View

ROUND = 10
# Of the runs of the first twelve whole rounds one in ten audits what the order implies to crash,
# and one in ten what only the order holds to be safe. Counted by runs: rounds may be shorter.
AUDIT_EVERY, AUDITED_ROUNDS = 10, 12
# Draws of the last round, as many as of one of ten that puts runs aside: to look much more often
# than after other rounds is to stop at the first lucky look (with three draws 1.4 % high in a toy).
FEWEST = 6


def size(problem: Problem, state: State) -> int:
    """Runs of the next round: a batch; large ones are grown into, small ones are put together.

    A thousand runs chosen by what forty taught would be spent at once; rounds of one run put none
    aside for learning. The budget has no say: what is asked for first must not depend on how much
    may come after.
    """
    return max(ROUND, min(problem.batch_size, state.labels.n // 2))


def size_to_learn(problem: Problem, state: State) -> int:
    """Runs of a round that learns: half of one that estimates, where that has ten.

    The second half is better chosen by what the first one taught. Whoever asks for more at a time
    has workers that would wait; and rounds that look at members are few, and counted.
    """
    halved = problem.batch_size <= ROUND and not state.members
    return size(problem, state) // (2 if halved else 1)


def audits_due(problem: Problem, state: State, n: int, shift: int = 0) -> int:
    """How many of the next `n` runs audit the order: none once enough of them have.

    Some of all draws that estimate are audits as well. `shift`: counted as if so many runs more
    had been made, for audits of two kinds that are to come by turns.
    """
    if not state.ordered:
        return 0
    most = AUDITED_ROUNDS * size(problem, state)
    done = min(state.labels.n - state.begun_at, most)
    return (min(done + n, most) + shift) // AUDIT_EVERY - (done + shift) // AUDIT_EVERY


def last(problem: Problem, state: State, view: View) -> int | None:
    """Draws of the next round if it is likely to be the last; None if it is not.

    Nothing need be put aside for later rounds then, nor more be drawn than the target asks for. The
    number follows from the past and the pool: the round stays unbiased.
    """
    aside = state.members or problem.aim_index is not None
    if aside or state.n_since < MIN_ROUNDS - 1:
        return None
    per_draw, of_pool = predicted_variance(view, estimating(view), 1), view.pool_variance
    so_far = combine(state.rounds, problem.confidence, state.least_inflation)
    if trust(problem, state, so_far, view.bounds()[1]).limit > 0:
        return None  # the rounds' own interval is not what stops it
    target = problem.target_at(state.labels.n)
    n = max(draws_to(target, so_far, per_draw, of_pool, problem.confidence), FEWEST)
    return math.ceil(n) if n <= size(problem, state) else None
