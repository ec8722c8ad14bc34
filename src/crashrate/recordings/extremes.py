"""A second opinion from one number: extreme-value theory on each event's margin to a crash.

The margin of a recorded event is the logarithm of the severity factor at which it begins to crash.
Margins of the worst events follow a generalised Pareto law (Balkema & de Haan 1974; Pickands 1975),
whatever the traffic; carried on to margin 0 it gives a crash probability that owes nothing to a
joint model. Of an event that crashes as it was recorded only that is used: how far beyond a crash
it lies says nothing of how rare one is.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import brentq, minimize_scalar
from scipy.special import xlog1py
from scipy.stats import chi2

from crashrate.recordings.stored import as_fields, as_stored
from crashrate.variables import FloatArray

MOST_EXCEEDANCES, LARGEST_SHARE = 250, 0.05  # a larger part of the events is no tail
MIN_EXCEEDANCES = 50
MOST_CRASHES = 0.2  # of the exceedances: where crashes are no rarity, the replay counts them
# Below -1/2 the likelihood is not regular, below -1 it has no maximum (Smith 1985).
SHAPES = (-0.5, 1.5)
IMPOSSIBLE = -1e300  # log likelihood: finite, so that searches can compare
LEAST_LOG = -70.0  # of the probability that an exceedance reaches a crash: 0 for all purposes
ALARM_CONFIDENCE = 0.99


@dataclass(frozen=True)
class Extremes:
    """The crash probability by extreme-value theory.

    Parameters
    ----------
    probability : float
        Per event.
    interval : (float, float)
        By profile likelihood, at the confidence asked for.
    alarm_interval : (float, float)
        Likewise, at 99 %: what it leaves out is refuted.
    shape : float
        Of the generalised Pareto law, at least -1/2; below 0 the margins end somewhere.
    n_exceedances : int
        Events it rests on: those of the smallest margins.
    threshold : float
        Their largest severity factor.
    """

    probability: float
    interval: tuple[float, float]
    alarm_interval: tuple[float, float]
    shape: float
    n_exceedances: int
    threshold: float

    def to_dict(self) -> dict[str, Any]:
        """As JSON-ready values."""
        return as_stored(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "Extremes":
        """What `to_dict` wrote."""
        return cls(**as_fields(values))


@dataclass(frozen=True, eq=False)
class _Exceedances:
    """What the worst margins exceed their threshold by; `reach` or more is a crash."""

    inside: FloatArray  # of those that do not crash
    n_crashes: int
    reach: float

    def log_likelihood(self, shape: float, log_s: float) -> float:
        """Of the generalised Pareto law that goes beyond `reach` with probability exp(log_s)."""
        y, scale = self.inside, _scale(log_s, shape, self.reach)
        if scale <= 0 or (len(y) and 1 + shape * y.max() / scale <= 0):
            return IMPOSSIBLE
        if abs(shape) < 1e-8:
            inside = -len(y) * np.log(scale) - y.sum() / scale
        else:
            inside = -len(y) * np.log(scale) - xlog1py(1 + 1 / shape, shape * y / scale).sum()
        return float(inside + self.n_crashes * log_s)

    def profile(self, log_s: float) -> tuple[float, float]:
        """Largest log likelihood given log_s, and the shape that has it."""
        grid = np.linspace(*SHAPES, 31)
        values = [self.log_likelihood(k, log_s) for k in grid]
        return _refined(lambda k: self.log_likelihood(k, log_s), grid, values)


def extremes(margins: FloatArray, n_events: int, confidence: float = 0.95) -> Extremes | None:
    """The crash probability from the smallest margins of n events.

    None where they are too few, or where so many of them crash that none is extreme.

    Parameters
    ----------
    margins : ndarray (k,)
        Of the k events of the smallest margins; a crash has one of 0 or less.
    n_events : int
    confidence : float
        Of `interval`.
    """
    ordered = np.sort(margins)
    n = min(MOST_EXCEEDANCES, int(LARGEST_SHARE * n_events), len(ordered) - 1)
    if n < MIN_EXCEEDANCES or not ordered[n] > 0:
        return None
    threshold, share = float(ordered[n]), n / n_events
    safe = ordered[:n][ordered[:n] > 0]
    if n - len(safe) > MOST_CRASHES * n:
        return None
    seen = _Exceedances(threshold - safe, n - len(safe), threshold)
    grid = np.concatenate([np.linspace(LEAST_LOG, -16, 19), np.linspace(-15, -0.02, 61)])
    top, best = _refined(lambda g: seen.profile(g)[0], grid, [seen.profile(g)[0] for g in grid])
    sides = [_ends(seen, best, top, level) for level in (confidence, ALARM_CONFIDENCE)]
    own, alarm = ((share * low, share * high) for low, high in sides)
    return Extremes(
        share * float(np.exp(best)) if best > LEAST_LOG + 1 else 0.0,
        own,
        alarm,
        seen.profile(best)[1],
        n,
        float(np.exp(threshold)),
    )


def _scale(log_s: float, shape: float, reach: float) -> float:
    """The scale at which an exceedance goes beyond `reach` with probability exp(log_s)."""
    if abs(shape) < 1e-8:
        return -reach / log_s
    return float(shape * reach / np.expm1(-shape * log_s))


def _refined(value: Any, grid: FloatArray, values: list[float]) -> tuple[float, float]:
    """The largest value between the neighbours of the best of a grid, and where it is."""
    top = int(np.argmax(values))
    sides = grid[max(top - 1, 0)], grid[min(top + 1, len(grid) - 1)]
    found = minimize_scalar(lambda v: -value(v), bounds=sides, method="bounded")
    if -found.fun >= values[top]:
        return float(-found.fun), float(found.x)
    return float(values[top]), float(grid[top])


def _ends(seen: _Exceedances, best: float, top: float, confidence: float) -> tuple[float, float]:
    """Where the profile falls short of its top by the likelihood ratio, either side."""
    cut = top - 0.5 * float(chi2.ppf(confidence, 1))

    def above(log_s: float) -> float:
        return seen.profile(log_s)[0] - cut

    last = -1e-6
    low = 0.0 if above(LEAST_LOG) >= 0 else float(np.exp(brentq(above, LEAST_LOG, best, xtol=1e-3)))
    high = 1.0 if above(last) >= 0 else float(np.exp(brentq(above, best, last, xtol=1e-3)))
    return low, high
