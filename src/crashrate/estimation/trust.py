"""Whether the rounds speak for themselves, and what the draws allow where they do not yet."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from crashrate.estimation.hits import upper_end
from crashrate.estimation.rounds import Combined, Round, counted
from crashrate.estimation.state import State
from crashrate.estimation.strategy import Problem

ENOUGH = 3  # hits: with fewer the rounds are the surrogate's word
# An interval of more than this share of the estimate to either side is of a few unequal
# contributions, and no Student's.
LOOSE = 0.5
# Of the surrogate's sums in so many rounds, largest over smallest: 1.03 to 1.5 where campaigns end.
SWING, N_RECENT = 5.0, 8
ENCOUNTERS_TAIL = 2  # the encounters' end beside the draws' limit: each may fail, it half as often


@dataclass(frozen=True)
class Trust:
    """How far the rounds are to be believed.

    Parameters
    ----------
    limit : float
        Upper end that the draws allow whatever the surrogate holds, or that random encounters show;
        0 where the rounds suffice, or their own upper end is above it.
    few, unsettled, outvoted : bool
        Why it counts: fewer than three hits; an estimate that is wide or still moves; encounters
        that exclude it.
    """

    limit: float = 0.0
    few: bool = False
    unsettled: bool = False
    outvoted: bool = False


def trust(problem: Problem, state: State, c: Combined, outer: float) -> Trust:
    """Of the rounds, combined to `c`, where the outcomes and the order leave at most `outer`."""
    found, e = _by_draws(problem, state, c, outer), state.encounters
    if e is None or not e.speak_against(c.upper):
        return found
    return replace(found, limit=max(found.limit, e.interval(problem.confidence)[1]), outvoted=True)


def _by_draws(problem: Problem, state: State, c: Combined, outer: float) -> Trust:
    rounds = counted(state.rounds)
    few = sum(r.hits.n for r in rounds) < ENOUGH
    # also by rounds that are left out since: they are what the surrogate held a short while ago
    unsettled = c.half_width > LOOSE * c.estimate or _swings(state.rounds)
    if not (few or unsettled):
        return Trust()
    limit = upper_end([r.hits for r in rounds], problem.confidence)
    if state.ordered and not state.labels.contradictions:
        limit = min(limit, outer)
    if state.encounters is not None:
        narrower = 1 - (1 - problem.confidence) / ENCOUNTERS_TAIL
        limit = min(limit, state.encounters.interval(narrower)[1])
    return Trust(limit, few, unsettled) if limit > c.upper else Trust()


def _swings(rounds: Sequence[Round]) -> bool:
    sums = [r.predicted for r in rounds[-N_RECENT:]]
    return max(sums) > SWING * min(sums)
