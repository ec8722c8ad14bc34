"""The severity ladder: recorded events made worse, against what the traffic model expects.

Crashes are too rare to be seen in recordings; the same events at a higher closing speed crash more
often, and how often, level by level, tests the tail of the model where crashes come from.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import xlogy

from crashrate.variables import FloatArray

MISFIT = 0.01  # the alarm's level
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
    def misfit(self) -> bool:
        """Whether the recordings refute the model's tail."""
        return self.p_value < MISFIT

    def to_dict(self) -> dict[str, Any]:
        """As JSON-ready values."""
        return {
            "levels": list(self.levels),
            "observed": list(self.observed),
            "expected": list(self.expected),
            "low": list(self.low),
            "high": list(self.high),
            "deviance": self.deviance,
            "p_value": self.p_value,
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "Ladder":
        """What `to_dict` wrote."""
        lists = ("levels", "observed", "expected", "low", "high")
        return cls(
            **{key: tuple(values[key]) for key in lists},
            deviance=float(values["deviance"]),
            p_value=float(values["p_value"]),
        )


def ladder(
    levels: tuple[float, ...],
    first: np.ndarray,
    masses: FloatArray,
    member_masses: FloatArray,
    rng: np.random.Generator,
) -> Ladder:
    """Compare events with a model, set by set.

    Parameters
    ----------
    levels : tuple of float, length J
    first : int array (n,)
        The level at which each event first crashes, J for none.
    masses : ndarray (J,)
        Probability of each under the model.
    member_masses : ndarray (M, J)
        And under its members.
    rng : Generator
        Simulates the deviance's law.
    """
    n, j = len(first), len(levels)
    counts = np.bincount(first, minlength=j + 1)[:j].astype(float)
    expected = n * masses
    value = float(deviance(counts, expected))
    by_chance = deviance(rng.poisson(expected, (N_SIMULATED, j)).astype(float), expected)
    low, high = _range(n * np.cumsum(member_masses, axis=1))
    return Ladder(
        levels,
        tuple(int(c) for c in np.cumsum(counts)),
        tuple(np.cumsum(expected).tolist()),
        low,
        high,
        value,
        float((1 + np.count_nonzero(by_chance >= value)) / (1 + N_SIMULATED)),
    )


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
