"""Random encounters: a few runs of ordinary traffic, where no risk order vouches for its safety.

They are the surrogate's only safe labels in ordinary traffic, and a check that no surrogate can
talk its way around: an estimate far below what they show is wrong.
"""

from collections.abc import Generator
from dataclasses import dataclass

import numpy as np
from scipy.special import betaincinv

from crashrate.estimation.labels import Labels
from crashrate.estimation.probing import EXPLORING, ask
from crashrate.estimation.strategy import Problem, Query, Snapshot
from crashrate.variables import FloatArray

N_ENCOUNTERS = 30
# One crash among thirty excludes, at this level, every probability below 8e-4.
LEVEL = 0.95


@dataclass(frozen=True)
class Encounters:
    """Simulated random encounters that did not fail.

    Parameters
    ----------
    n, n_crashes : int
    """

    n: int = 0
    n_crashes: int = 0

    def __add__(self, other: "Encounters") -> "Encounters":
        return Encounters(self.n + other.n, self.n_crashes + other.n_crashes)

    def speak_against(self, upper: float) -> bool:
        """Whether they exclude a probability of `upper` or less."""
        return interval(self.n_crashes, self.n, LEVEL)[0] > upper


def meet(
    problem: Problem, labels: Labels, rng: np.random.Generator, snapshot: Snapshot = EXPLORING
) -> Generator[Query, FloatArray, tuple[Labels, Encounters]]:
    """Simulate random encounters."""
    x = problem.traffic.sample(N_ENCOUNTERS, rng)
    before = labels.n
    labels = yield from ask(problem, labels, x, snapshot)
    y = labels.y[before:]
    known = y[~np.isnan(y)]
    return labels, Encounters(len(known), int(known.sum()))


def interval(n_crashes: int, n: int, confidence: float) -> tuple[float, float]:
    """Two-sided Clopper–Pearson interval (1934) for a probability; (0, 1) without a run."""
    tail = (1 - confidence) / 2
    low = float(betaincinv(n_crashes, n - n_crashes + 1, tail)) if n_crashes > 0 else 0.0
    high = float(betaincinv(n_crashes + 1, n - n_crashes, 1 - tail)) if n_crashes < n else 1.0
    return low, high
