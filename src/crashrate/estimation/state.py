"""What the default method knows between two rounds."""

import math
from dataclasses import dataclass, replace
from typing import Self

from crashrate.crash_set.surrogate import Surrogate
from crashrate.estimation.direction import LEARNING_ROUNDS, Members
from crashrate.estimation.encounters import Encounters
from crashrate.estimation.hindsight import reconsider
from crashrate.estimation.kernels import Model
from crashrate.estimation.labels import Labels
from crashrate.estimation.rounds import MIN_INFLATION, Round
from crashrate.estimation.view import held
from crashrate.sampling.pool import Density
from crashrate.variables import FloatArray

# Beyond so many runs a wide interval is better than none. (Not a share of the budget: a run whose
# budget grows must go on as it was.)
LEARNING_RUNS = 300
LATE_RUNS = 200  # where the first crash came late: nothing was known of its region before
RELEARNING_RUNS = 100  # after an order was dropped, or a last look was surprised
# What was seen may narrow an interval; not without an order, which nothing could contradict.
MIN_UNORDERED = 1.0
# The share of the estimate whose part in the variance is left out, over the target: a bias of a
# tenth of a standard error in the campaigns, nearly all, that do not meet such a crash.
NEGLECTED = 0.05


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
    rounds : tuple of Round
        Those that estimate.
    encounters : Encounters or None
        Ordinary traffic, simulated where no order is in use.
    directed : bool
        Whether danger grows along the coordinates, though outcomes may not imply one another.
    dropped_at, shaken_at : int or None
        Simulator runs when the order was dropped, and when a last look was last surprised.
    shaken : tuple of Round
        Rounds before that look: a first idea, where no others follow.
    begun_at : int
        Simulator runs before the first round.
    k : int
        Number of the round.
    learning : bool
        Whether the last round was spent on learning.
    members : tuple of int
        Of the traffic model: those that the next round is directed at, if any.
    n_directed : int
        Rounds so far that were directed at members.
    n_surveys : int
        Looks so far, once the target was met, at places far from all runs.
    surveyed_for : float
        The tightest target for which the last of them met no surprise, or they were at an end.
    surprised : bool
        Whether the last of them met one.
    tested : bool
        Whether what the order does not see was, as far as it is.
    followed : tuple of int
        Rows of the labels beside which was looked, or that were asked for it.
    foreseen : tuple of float
        The surrogate's sums over the latest pools, since one round would tell.
    """

    labels: Labels
    ordinary: FloatArray
    proposal: Density
    model: Model
    rounds: tuple[Round, ...] = ()
    encounters: Encounters | None = None
    directed: bool = True
    dropped_at: int | None = None
    shaken_at: int | None = None
    shaken: tuple[Round, ...] = ()
    begun_at: int = 0
    k: int = 1
    learning: bool = True
    members: Members = ()
    n_directed: int = 0
    n_surveys: int = 0
    surveyed_for: float = math.inf
    surprised: bool = False
    tested: bool = False
    followed: tuple[int, ...] = ()
    foreseen: tuple[float, ...] = ()

    @property
    def least_inflation(self) -> float:
        """Of the predicted variance: how far the interval may narrow with what was seen."""
        return MIN_INFLATION if self.ordered else MIN_UNORDERED

    def neglected(self, target: float) -> float:
        """Share of the estimate that is left out of a round's variance, for a target.

        Nothing without an order: the surrogate alone says there what is unlikely.
        """
        return NEGLECTED * target if self.ordered else 0.0

    @property
    def n_since(self) -> int:
        """Rounds since a last look was surprised; all where none was."""
        kept = len(self.shaken) if self.ordered else 0
        return len(self.rounds) - kept

    @property
    def ordered(self) -> bool:
        """Whether a risk order is in use."""
        return self.labels.learned is not None

    @property
    def may_learn(self) -> bool:
        """Whether runs may still go into learning alone."""
        if self.members:
            return self.n_directed <= LEARNING_ROUNDS
        anew = [at + RELEARNING_RUNS for at in (self.dropped_at, self.shaken_at) if at is not None]
        return self.labels.n < max(LEARNING_RUNS, self.begun_at + LATE_RUNS, *anew)

    def fit(self) -> tuple[Surrogate, Model]:
        """The surrogate of all outcomes so far."""
        # learning again: the kernel was a bad choice, and would stay for another seventh of the
        # runs
        again = not self.ordered and self.learning and bool(self.rounds)
        return self.model.fit(self.labels, self.ordinary, directed=self.directed, again=again)

    def reconsidered(self, surrogate: Surrogate, model: Model) -> Self:
        """With the rounds' variances by what is known now."""

        def hold(u: FloatArray) -> FloatArray:
            return held(u, self.labels, surrogate, model.standardise)[0]

        return replace(self, rounds=reconsider(self.rounds, hold))
