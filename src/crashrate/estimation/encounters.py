"""Random encounters: a few runs of ordinary traffic, where no risk order vouches for its safety.

They are the surrogate's only safe labels in ordinary traffic, and a check that no surrogate can
talk its way around: an estimate far below what they show is wrong.
"""

import math
from collections.abc import Generator
from dataclasses import dataclass
from typing import Self

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
    """Simulated random encounters.

    Parameters
    ----------
    n, n_crashes : int
        That did not fail, and that crashed.
    n_failed : int
        Simulations that failed, beside the `n`.
    """

    n: int = 0
    n_crashes: int = 0
    n_failed: int = 0

    @classmethod
    def of(cls, outcomes: FloatArray) -> Self:
        """Those with `outcomes` (n,): 1 crash, 0 safe, NaN failed."""
        known = outcomes[~np.isnan(outcomes)]
        return cls(len(known), int(known.sum()), len(outcomes) - len(known))

    def __add__(self, other: Self) -> Self:
        return type(self)(
            self.n + other.n,
            self.n_crashes + other.n_crashes,
            self.n_failed + other.n_failed,
        )

    @property
    def n_runs(self) -> int:
        """Simulator runs, the failed ones included."""
        return self.n + self.n_failed

    @property
    def share(self) -> float:
        """Share of crashes among the runs that did not fail; NaN where there is none."""
        return self.n_crashes / self.n if self.n else math.nan

    def interval(self, confidence: float) -> tuple[float, float]:
        """Clopper–Pearson, failed runs counted as safe at its lower end, as crashes at its upper.

        For a number of runs that was chosen before any outcome.
        """
        low, _ = interval(self.n_crashes, self.n_runs, confidence)
        _, high = interval(self.n_crashes + self.n_failed, self.n_runs, confidence)
        return low, high

    def speak_against(self, upper: float) -> bool:
        """Whether they exclude a probability of `upper` or less, were all failed runs safe."""
        return self.interval(LEVEL)[0] > upper


def meet(
    problem: Problem, labels: Labels, rng: np.random.Generator, snapshot: Snapshot = EXPLORING
) -> Generator[Query, FloatArray, tuple[Labels, Encounters]]:
    """Simulate random encounters."""
    x = problem.traffic.sample(N_ENCOUNTERS, rng)
    before = labels.n
    labels = yield from ask(problem, labels, x, snapshot)
    return labels, Encounters.of(labels.y[before:])


def interval(n_crashes: int, n: int, confidence: float) -> tuple[float, float]:
    """Two-sided Clopper–Pearson interval (1934) for a probability; (0, 1) without a run."""
    tail = (1 - confidence) / 2
    low = float(betaincinv(n_crashes, n - n_crashes + 1, tail)) if n_crashes > 0 else 0.0
    high = float(betaincinv(n_crashes + 1, n - n_crashes, 1 - tail)) if n_crashes < n else 1.0
    return low, high
