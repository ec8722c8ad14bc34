"""A second opinion from one number: extreme-value theory on each event's margin to a crash.

The margin of a recorded event is the logarithm of the severity factor at which it begins to crash.
Margins of the worst events follow a generalised Pareto law (Balkema & de Haan 1974; Pickands 1975),
whatever the traffic; carried on to margin 0 it gives a crash probability that owes nothing to a
joint model.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import brentq, minimize_scalar
from scipy.special import xlog1py
from scipy.stats import chi2

from crashrate.variables import FloatArray

N_EXCEEDANCES = 250
MIN_EXCEEDANCES = 30
SHAPES = (-2.0, 1.5)
IMPOSSIBLE = -1e300  # log likelihood: finite, so that searches can compare
LEAST_LOG = -70.0  # of the probability that an exceedance reaches a crash: 0 for all purposes


@dataclass(frozen=True)
class Extremes:
    """The crash probability by extreme-value theory.

    Parameters
    ----------
    probability : float
        Per event; 0 where the fitted law ends before a crash.
    interval : (float, float)
        95 %, by profile likelihood.
    shape : float
        Of the generalised Pareto law: below 0 the margins end somewhere.
    n_exceedances : int
        Events it rests on: those of the smallest margins.
    threshold : float
        Their largest severity factor.
    """

    probability: float
    interval: tuple[float, float]
    shape: float
    n_exceedances: int
    threshold: float

    def to_dict(self) -> dict[str, Any]:
        """As JSON-ready values."""
        return {
            "probability": self.probability,
            "interval": list(self.interval),
            "shape": self.shape,
            "n_exceedances": self.n_exceedances,
            "threshold": self.threshold,
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "Extremes":
        """What `to_dict` wrote."""
        low, high = values["interval"]
        return cls(**{**values, "interval": (float(low), float(high))})


def extremes(margins: FloatArray, n_events: int, confidence: float = 0.95) -> Extremes | None:
    """The crash probability from the smallest margins of n events; None where they are too few.

    Parameters
    ----------
    margins : ndarray (k,)
        Of the k events of the smallest margins; a crash has one of 0 or less.
    n_events : int
    confidence : float
    """
    ordered = np.sort(margins)
    n = min(N_EXCEEDANCES, len(ordered) - 1)
    if n < MIN_EXCEEDANCES or not ordered[n] > 0:
        return None
    threshold = float(ordered[n])
    fall = threshold - ordered[:n]  # exceedances of -margin over -threshold, crash at `threshold`
    share = n / n_events
    best = _most_likely(fall, threshold)
    cut = best[1] - 0.5 * float(chi2.ppf(confidence, 1))
    low, high = _ends(fall, threshold, best[0], cut)
    return Extremes(
        share * float(np.exp(best[0])),
        (share * low, share * high),
        _profile(best[0], fall, threshold)[1],
        n,
        float(np.exp(threshold)),
    )


def _log_likelihood(shape: float, scale: float, y: FloatArray) -> float:
    """Of the generalised Pareto law at exceedances y."""
    if scale <= 0 or 1 + shape * y.max() / scale <= 0:
        return IMPOSSIBLE
    if abs(shape) < 1e-8:
        return float(-len(y) * np.log(scale) - y.sum() / scale)
    return float(-len(y) * np.log(scale) - xlog1py(1 + 1 / shape, shape * y / scale).sum())


def _scale(log_s: float, shape: float, reach: float) -> float:
    """The scale at which an exceedance goes beyond `reach` with probability exp(log_s)."""
    if abs(shape) < 1e-8:
        return -reach / log_s
    return float(shape * reach / np.expm1(-shape * log_s))


def _profile(log_s: float, y: FloatArray, reach: float) -> tuple[float, float]:
    """Largest log likelihood given log_s, and the shape that has it."""
    grid = np.linspace(*SHAPES, 36)
    values = [_log_likelihood(k, _scale(log_s, k, reach), y) for k in grid]
    top = int(np.argmax(values))
    sides = grid[max(top - 1, 0)], grid[min(top + 1, len(grid) - 1)]
    found = minimize_scalar(
        lambda k: -_log_likelihood(k, _scale(log_s, k, reach), y), bounds=sides, method="bounded"
    )
    if -found.fun >= values[top]:
        return float(-found.fun), float(found.x)
    return float(values[top]), float(grid[top])


def _most_likely(y: FloatArray, reach: float) -> tuple[float, float]:
    """The likeliest log probability of reaching a crash, and its log likelihood."""
    grid = np.concatenate([np.linspace(LEAST_LOG, -16, 19), np.linspace(-15, -0.05, 61)])
    values = [_profile(g, y, reach)[0] for g in grid]
    top = int(np.argmax(values))
    sides = grid[max(top - 1, 0)], grid[min(top + 1, len(grid) - 1)]
    found = minimize_scalar(lambda g: -_profile(g, y, reach)[0], bounds=sides, method="bounded")
    if -found.fun >= values[top]:
        return float(found.x), float(-found.fun)
    return float(grid[top]), values[top]


def _ends(y: FloatArray, reach: float, best: float, cut: float) -> tuple[float, float]:
    """Where the profile falls to `cut`, either side of the best."""

    def above(log_s: float) -> float:
        return _profile(log_s, y, reach)[0] - cut

    low = 0.0 if above(LEAST_LOG) >= 0 else float(np.exp(brentq(above, LEAST_LOG, best, xtol=1e-3)))
    top = -1e-6
    high = 1.0 if above(top) >= 0 else float(np.exp(brentq(above, best, top, xtol=1e-3)))
    return low, high
