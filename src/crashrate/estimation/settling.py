"""Labels for a set of draws: what the risk order decides costs no simulator run."""

from collections.abc import Generator
from dataclasses import dataclass

import numpy as np

from crashrate.estimation.antichain import antichain
from crashrate.estimation.labels import Labels
from crashrate.estimation.strategy import Problem, Query, Snapshot
from crashrate.variables import BoolArray, FloatArray


@dataclass(frozen=True)
class Settled:
    """Draws and what is known of them.

    Parameters
    ----------
    labels : Labels
        All outcomes so far, those of the draws included.
    u : (n, m) array
        The draws' risk coordinates.
    outcomes : (n,) array
        1 crash, 0 safe; NaN where it was not simulated, or the simulation failed.
    simulated : (n,) bool array
    """

    labels: Labels
    u: FloatArray
    outcomes: FloatArray
    simulated: BoolArray

    @property
    def implied(self) -> FloatArray:
        """What the order implies, (n,): 1 crash, 0 safe, NaN undecided."""
        crash, safe = self.labels.implied(self.u)
        return np.where(crash, 1.0, np.where(safe, 0.0, np.nan))

    @property
    def known(self) -> FloatArray:
        """The outcome, (n,), or else what the order implies; NaN where neither is known."""
        return np.where(np.isnan(self.outcomes), self.implied, self.outcomes)


def settle(
    problem: Problem, labels: Labels, x: FloatArray, budget: int, snapshot: Snapshot
) -> Generator[Query, FloatArray, Settled]:
    """Simulate undecided draws, a few at a time, until all of them are decided.

    Parameters
    ----------
    problem : Problem
    labels : Labels
        So far; with a learned set.
    x : (n, d) array
        Draws.
    budget : int
        Ends it as well: simulator runs, all that came before included.
    snapshot : Snapshot
        Goes out with the queries.
    """
    u = labels.coordinates(x)
    outcomes, simulated = np.full(len(x), np.nan), np.zeros(len(x), dtype=np.bool_)
    while labels.n < budget:
        left = np.flatnonzero(~simulated)
        crash, safe = labels.implied(u[left])
        left = left[~(crash | safe)]
        if not len(left):
            break
        rows = left[antichain(u[left], min(problem.batch_size, budget - labels.n))]
        y = yield Query(x[rows], snapshot)
        labels = labels.add(x[rows], y)
        outcomes[rows], simulated[rows] = y, True
    return Settled(labels, u, outcomes, simulated)
