"""One variable's law: a truncated mixture, with a generalised Pareto tail where no side bounds it.

For comparison with the joint model only: see `alternatives`.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import ndtr, ndtri
from scipy.stats import genpareto

from crashrate.traffic.components import select_components
from crashrate.traffic.model import TrafficModel
from crashrate.variables import FloatArray, frozen

CANDIDATES = (1, 2, 4)
TAIL_SHARE = 0.025  # of the events, beyond which the Pareto law takes over
MIN_BEYOND, LEAST_SHAPE = 30, -0.5
N_GRID = 2049
N_NEWTON = 4
SPREAD = 9.0  # deviations beyond which a component has next to nothing
LEAST = 1e-300


@dataclass(frozen=True)
class ParetoTail:
    """The law beyond `threshold`, with probability `share`."""

    threshold: float
    share: float
    shape: float
    scale: float

    @classmethod
    def of(cls, values: FloatArray) -> "ParetoTail | None":
        """Maximum likelihood on the largest values; None where they are too few, or no tail."""
        threshold = float(np.quantile(values, 1 - TAIL_SHARE))
        beyond = values[values > threshold] - threshold
        if len(np.unique(beyond)) < MIN_BEYOND:
            return None
        shape, _, scale = genpareto.fit(beyond, floc=0.0)
        if shape < LEAST_SHAPE:  # no regular maximum: values that pile up at an end
            return None
        return cls(threshold, len(beyond) / len(values), float(shape), float(scale))

    def log_density(self, z: FloatArray) -> FloatArray:
        """Log density (n,) of values beyond the threshold."""
        law = genpareto.logpdf(z - self.threshold, self.shape, scale=self.scale)
        return np.asarray(np.log(self.share) + law)

    def above(self, z: FloatArray) -> FloatArray:
        """Probability (n,) of a larger value."""
        return np.asarray(
            self.share * genpareto.sf(z - self.threshold, self.shape, scale=self.scale)
        )

    def quantile_above(self, p: FloatArray) -> FloatArray:
        """The value that is exceeded with probability p (n,) below `share`."""
        law = genpareto.isf(p / self.share, self.shape, scale=self.scale)
        return np.asarray(self.threshold + law)


@dataclass(frozen=True, eq=False)
class Margin:
    """The law of one variable, on its modelled scale.

    Parameters
    ----------
    body : TrafficModel
        In one variable.
    tail : ParetoTail or None
        Takes the body's place above its threshold.
    """

    body: TrafficModel
    tail: ParetoTail | None

    @classmethod
    def of(cls, values: FloatArray, lower: float, upper: float) -> "Margin":
        """The margin of events (n,) as a mixture alone, its number of components by BIC."""
        fit = select_components(values[:, None], CANDIDATES, lower=[lower], upper=[upper])
        return cls(fit.traffic_model(("z",)), None)

    def with_tail(self, values: FloatArray) -> "Margin":
        """With a Pareto tail fitted to the largest of the events, where no side bounds them."""
        open_above = bool(np.isinf(self.body.upper[0]))
        return Margin(self.body, ParetoTail.of(values)) if open_above else self

    @property
    def n_parameters(self) -> int:
        """Free parameters."""
        return 3 * self.body.n_components - 1 + (3 if self.tail else 0)

    @cached_property
    def _rest(self) -> float:
        """Share of the law that the body keeps, over its own mass there."""
        if self.tail is None:
            return 1.0
        below = float(self._body_below(np.array([self.tail.threshold]))[0])
        return (1 - self.tail.share) / below

    def _body_below(self, z: FloatArray) -> FloatArray:
        """Probability (n,) of a smaller value under the body alone."""
        mean, deviation = self.body.means[:, 0], np.sqrt(self.body.covariances[:, 0, 0])
        low = ndtr((self.body.lower[0] - mean) / deviation)
        parts = ndtr((z[:, None] - mean) / deviation) - low
        return np.asarray(np.clip(parts / self.body.component_masses, 0, 1) @ self.body.weights)

    def log_density(self, z: FloatArray) -> FloatArray:
        """Log density at z (n,); -inf outside the bounds."""
        out: FloatArray = self.body.log_density(z[:, None]) + np.log(self._rest)
        if self.tail is not None:
            beyond = z > self.tail.threshold
            out[beyond] = self.tail.log_density(z[beyond])
        return out

    def below(self, z: FloatArray) -> FloatArray:
        """Probability (n,) of a smaller value."""
        return np.asarray(np.clip(self._rest * self._body_below(z), LEAST, 1.0))

    def normal_scores(self, z: FloatArray) -> FloatArray:
        """The standard normal quantiles (n,) of z's own probabilities."""
        scores = ndtri(np.clip(self.below(z), LEAST, 1 - 1e-16))
        if self.tail is not None:
            beyond = z > self.tail.threshold
            scores[beyond] = -ndtri(np.maximum(self.tail.above(z[beyond]), LEAST))
        return np.asarray(scores)

    def of_scores(self, scores: FloatArray) -> FloatArray:
        """Values (n,) with these standard normal scores."""
        p, (grid, levels) = ndtr(scores), self._grid
        cell = np.clip(np.searchsorted(levels, p), 1, len(grid) - 1)
        z = np.interp(p, levels, grid)
        for _ in range(N_NEWTON):  # the density is the slope
            slope = np.exp(self.log_density(z))
            step = (self.below(z) - p) / np.maximum(slope, 1e-12)
            z = np.clip(z - step, grid[cell - 1], grid[cell])
        if self.tail is not None:
            beyond = ndtr(-scores) < self.tail.share
            z[beyond] = self.tail.quantile_above(ndtr(-scores[beyond]))
        return np.asarray(z)

    @cached_property
    def _grid(self) -> tuple[FloatArray, FloatArray]:
        """Values that hold all but a rounding of each of the body's components; shares below.

        Of each by itself: a rare wide one reaches far beyond what the deviation of all says.
        """
        center = self.body.component_means[:, 0]
        spread = SPREAD * np.sqrt(self.body.covariances[:, 0, 0])
        ends = center + np.array([[-1.0], [1.0]]) * spread
        low, high = np.clip(ends, self.body.lower[0], self.body.upper[0])
        values = np.unique(np.linspace(low, high, N_GRID))
        return frozen(values), frozen(self.below(values))
