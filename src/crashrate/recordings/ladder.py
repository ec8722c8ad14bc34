"""The severity ladder: recorded events made worse, against what the traffic model expects.

Crashes are too rare to be seen in recordings; the same events at a higher closing speed crash more
often, and how often, level by level, tests the tail of the model where crashes come from.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import xlogy

from crashrate.recordings.expectation import Draws
from crashrate.recordings.stored import as_fields, as_stored
from crashrate.variables import FloatArray

MISFIT = 0.01  # the alarm's level
LEAST_EXPECTED = 1.0  # crashes at the highest level, for the absence of any to say something
N_SIMULATED = 20_000  # draws of the deviance's law: exact where few crashes are expected


@dataclass(frozen=True, eq=False)
class Ladder:
    """Crash counts at growing severity.

    Parameters
    ----------
    levels : tuple of float, length J
    observed : tuple of int, length J
        Recorded events that crash at each level.
    expected : tuple of float, length J
        By the traffic model, for as many events.
    low, high : tuple of float, length J
        5 and 95 % of what its members expect; empty where it has none.
    deviance : float
        Of the increments from level to level, taken as Poisson counts.
    p_value : float
        Chance of a larger deviance if the model is right.
    """

    levels: tuple[float, ...]
    observed: tuple[int, ...]
    expected: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    deviance: float
    p_value: float

    @property
    def tested(self) -> bool:
        """Whether being worse makes any difference here: else the ladder says nothing."""
        return max(self.observed) > 0 or max(self.expected) >= LEAST_EXPECTED

    @property
    def misfit(self) -> bool:
        """Whether the recordings refute the model's tail."""
        return self.p_value < MISFIT

    def to_dict(self) -> dict[str, Any]:
        """As JSON-ready values."""
        return as_stored(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "Ladder":
        """What `to_dict` wrote."""
        return cls(**as_fields(values))


def ladder(
    levels: tuple[float, ...],
    first: np.ndarray,
    draws: Draws,
    rng: np.random.Generator,
    members: FloatArray | None = None,
) -> Ladder:
    """Compare events with a model, set by set.

    Parameters
    ----------
    levels : tuple of float, length J
    first : int array (n,)
        The level at which each event first crashes, J for none.
    draws : Draws
        Of the model in the sets: give the expected counts, and their errors.
    rng : Generator
        Simulates the deviance's law.
    members : ndarray (M, J), optional
        Probabilities of the sets under the model's members.
    """
    n, j = len(first), len(levels)
    counts = np.bincount(first, minlength=j + 1)[:j].astype(float)
    met = draws.probabilities > 0  # of a set that no draw met nothing is known but that it is rare
    expected, errors = n * draws.probabilities[met], n * draws.standard_errors[met]
    value = float(deviance(counts[met], expected))
    by_chance = deviance(_counts(expected, errors, rng), expected)
    low, high = _range(n * np.cumsum(np.empty((0, j)) if members is None else members, axis=1))
    return Ladder(
        levels,
        tuple(int(c) for c in np.cumsum(counts)),
        tuple(np.cumsum(n * draws.probabilities).tolist()),
        low,
        high,
        value,
        float((1 + np.count_nonzero(by_chance >= value)) / (1 + N_SIMULATED)),
    )


def _counts(expected: FloatArray, errors: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Counts (N, J) as they would come from a right model, whose expectation is known to errors.

    A Gamma law of the true expectation: without it a table of a million events would refute any
    model by the errors of its own integral.
    """
    relative = np.maximum(errors / expected, 1e-6)
    shape = (N_SIMULATED, len(expected))
    truth = expected * rng.gamma(relative**-2, relative**2, shape)
    return np.asarray(rng.poisson(truth), dtype=np.float64)


def deviance(counts: FloatArray, expected: FloatArray) -> FloatArray:
    """Poisson deviance 2 Σ (o log(o / e) - (o - e)) over the last axis (McCullagh & Nelder)."""
    with np.errstate(divide="ignore"):
        parts = xlogy(counts, counts) - xlogy(counts, expected) - (counts - expected)
    return np.asarray(2 * parts.sum(axis=-1))


def _range(members: FloatArray) -> tuple[tuple[float, ...], tuple[float, ...]]:
    if not len(members):
        return (), ()
    low, high = np.quantile(members, (0.05, 0.95), axis=0)
    return tuple(low.tolist()), tuple(high.tolist())
