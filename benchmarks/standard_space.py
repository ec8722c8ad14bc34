"""From standard normal variables to the situations of a Gaussian mixture, and back (Rosenblatt)."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import log_ndtr, log_softmax, ndtri_exp

from crashrate.traffic.model import TrafficModel

Rows = npt.NDArray[np.float64]


@dataclass(frozen=True)
class StandardSpace:
    """Standard normal variables behind a Gaussian mixture without its box.

    Coordinate i of x, given those before it, has a law in one dimension that is again a mixture;
    u_i is the standard normal number with the same probability below it (Rosenblatt 1952).

    A truncated mixture has no such transform in closed form. Its untruncated one has, and
    P(crash) = P(crash and inside the box) / `p_box`.

    Parameters
    ----------
    weights : ndarray (K,)
        Of the untruncated components.
    means : ndarray (K, d)
    factors : ndarray (K, d, d)
        Lower Cholesky factors of their covariances.
    p_box : float
        Probability of the box under the untruncated mixture.
    """

    weights: Rows
    means: Rows
    factors: Rows
    p_box: float

    @classmethod
    def of(cls, traffic: TrafficModel) -> "StandardSpace":
        """Of a traffic model, whose weights are those of the truncated components."""
        raw = traffic.weights / np.exp(traffic.log_masses)
        factors = np.linalg.cholesky(traffic.covariances)
        return cls(raw / raw.sum(), np.asarray(traffic.means), factors, float(1 / raw.sum()))

    def to_situations(self, u: Rows) -> Rows:
        """Standard normal rows (n, d) to situations (n, d)."""
        if len(self.weights) == 1:
            return np.asarray(self.means[0] + u @ self.factors[0].T)
        x = np.empty_like(u)
        state = _Conditionals(self, len(u))
        for i in range(u.shape[1]):
            x[:, i] = _quantile(u[:, i], *state.mixture(i))
            state.condition(i, x[:, i])
        return x

    def to_standard(self, x: Rows) -> Rows:
        """Situations (n, d) to standard normal rows (n, d)."""
        u = np.empty_like(x)
        state = _Conditionals(self, len(x))
        for i in range(x.shape[1]):
            u[:, i] = _score(x[:, i], *state.mixture(i))
            state.condition(i, x[:, i])
        return u


class _Conditionals:
    """The law of each coordinate given those before it, row by row."""

    def __init__(self, space: StandardSpace, n: int) -> None:
        self._space = space
        # z of a component is its own standard normal vector: x = m + L z
        self._z = np.empty((n, *space.means.shape))
        self._log_weights = np.tile(np.log(space.weights), (n, 1))

    def mixture(self, i: int) -> tuple[Rows, Rows, Rows]:
        """Log weights (n, K), means (n, K) and deviations (K,) of coordinate i."""
        factors = self._space.factors
        shift = np.einsum("nkj,kj->nk", self._z[:, :, :i], factors[:, i, :i])
        return self._log_weights, self._space.means[:, i] + shift, factors[:, i, i]

    def condition(self, i: int, x: Rows) -> None:
        _, m, s = self.mixture(i)
        self._z[:, :, i] = (x[:, None] - m) / s
        log_weights = self._log_weights - self._z[:, :, i] ** 2 / 2 - np.log(s)
        self._log_weights = log_softmax(log_weights, axis=1)


def _score(x: Rows, log_w: Rows, m: Rows, s: Rows) -> Rows:
    """The standard normal number with the same probability below it as `x` in the mixture.

    By the smaller of the two tails, in logarithms: the other is 1 up to rounding, and solvers try
    steps so long that even the smaller one is 0 up to rounding.
    """
    z = (x[:, None] - m) / s
    below = np.logaddexp.reduce(log_w + log_ndtr(z), axis=1)
    above = np.logaddexp.reduce(log_w + log_ndtr(-z), axis=1)
    return np.asarray(np.where(below < above, ndtri_exp(below), -ndtri_exp(above)))


def _quantile(u: Rows, log_w: Rows, m: Rows, s: Rows) -> Rows:
    """The inverse of `_score`: Newton's method on it, kept inside a bracket.

    The score is linear for one component and nearly so for several. The quantiles of the
    components bracket that of the mixture.
    """
    quantiles = m + s * u[:, None]
    low, high = quantiles.min(axis=1), quantiles.max(axis=1)
    x = (np.exp(log_w) * quantiles).sum(axis=1)
    for _ in range(100):
        error = _score(x, log_w, m, s) - u
        low, high = np.where(error < 0, x, low), np.where(error > 0, x, high)
        ahead = x - _newton(error, x, u, (log_w, m, s))
        ahead = np.where((low <= ahead) & (ahead <= high), ahead, (low + high) / 2)
        # Newton's method doubles the digits: after a step this short, the next one is rounding
        if np.all(np.abs(ahead - x) <= 1e-8 * (1 + np.abs(x))):
            return np.asarray(ahead)
        x = ahead
    raise ArithmeticError(
        f"quantile of a mixture: expected 100 steps to suffice, {np.abs(ahead - x).max():.2g} left."
    )


def _newton(error: Rows, x: Rows, u: Rows, mixture: tuple[Rows, Rows, Rows]) -> Rows:
    """Error over slope of the score; infinite, for bisection to step in, where no slope is."""
    log_w, m, s = mixture
    z = (x[:, None] - m) / s
    log_densities = log_w - np.log(s) - z * z / 2
    log_slope = (u + error) ** 2 / 2 + np.logaddexp.reduce(log_densities, axis=1)
    usable = np.abs(log_slope) < 300
    return np.asarray(np.where(usable, error * np.exp(np.where(usable, -log_slope, 0.0)), np.inf))
