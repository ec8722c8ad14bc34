"""Plain Gaussian mixtures: the cheap proposals of the pool, and their fit to weighted draws."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular

from crashrate.traffic.log_mixture import LogMixture
from crashrate.variables import FloatArray

EM_STEPS = 15
MIN_THICKNESS = 1e-4
ROUNDED = 1e-6  # least standard deviation over the size of the numbers


@dataclass(frozen=True)
class Gaussians:
    """A mixture of untruncated Gaussians.

    Parameters
    ----------
    weights : ndarray, shape (K,)
        Sum to one.
    means : ndarray, shape (K, d)
    covariances : ndarray, shape (K, d, d)
    """

    weights: FloatArray
    means: FloatArray
    covariances: FloatArray

    @cached_property
    def _chol(self) -> FloatArray:
        return np.asarray(np.linalg.cholesky(self.covariances), dtype=np.float64)

    @cached_property
    def _mixture(self) -> LogMixture:
        shift = self.weights @ self.means
        variances = np.diagonal(self.covariances, axis1=1, axis2=2) + (self.means - shift) ** 2
        scale = np.sqrt(self.weights @ variances)
        none = np.zeros(len(self.weights))  # no box: the whole mass
        return LogMixture.of(
            self.weights, none, self.means, self.covariances, shift=shift, scale=scale
        )

    def log_density(self, x: FloatArray) -> FloatArray:
        """Log density at `x` (n, d), shape (n,)."""
        return self._mixture.log_density(x)

    def component_probabilities(self, x: FloatArray) -> FloatArray:
        """Probability that each of `x` (n, d) came from each component, shape (n, K)."""
        return self._mixture.shares(x)

    def sample(self, n: int, rng: np.random.Generator) -> FloatArray:
        """`n` draws, grouped by component, shape (n, d)."""
        component = np.repeat(np.arange(len(self.weights)), rng.multinomial(n, self.weights))
        z = rng.standard_normal((n, self.means.shape[1]))
        return np.asarray(self.means[component] + np.einsum("nij,nj->ni", self._chol[component], z))


def fit_gaussians(x: FloatArray, n_components: int, rng: np.random.Generator) -> Gaussians:
    """Fit a mixture to draws by EM, covariances shrunk towards that of all draws.

    Parameters
    ----------
    x : ndarray, shape (n, d)
        Draws; repeated rows stand for weights.
    n_components : int
    rng : Generator
        Chooses the starting means.
    """
    center, scale = x.mean(axis=0), x.std(axis=0)
    # draws that differ in their last digits only have no density that could be computed
    scale = np.maximum(scale, ROUNDED * np.abs(x).max(axis=0))
    scale = np.where(scale > 0, scale, 1.0)
    z = (x - center) / scale
    # whitened: draws may lie along a line, ten thousand times as thin as it is long
    root = np.linalg.cholesky(np.atleast_2d(np.cov(z.T)) + MIN_THICKNESS**2 * np.eye(x.shape[1]))
    fit = _em(solve_triangular(root, z.T, lower=True).T, n_components, rng)
    root = scale[:, None] * root
    covariances = root @ fit.covariances @ root.T
    return Gaussians(fit.weights, fit.means @ root.T + center, covariances)


def _em(z: FloatArray, n_components: int, rng: np.random.Generator) -> Gaussians:
    n, d = z.shape
    whole = np.atleast_2d(np.cov(z.T)) + 1e-4 * np.eye(d)
    target = whole * n_components ** (-2 / d)  # a component's share of the space
    fit = Gaussians(
        np.full(n_components, 1 / n_components),
        z[rng.choice(n, n_components, replace=False)],
        np.repeat(target[None], n_components, axis=0),
    )
    for _ in range(EM_STEPS):
        fit = _em_step(z, fit, target)
    return fit


def _em_step(z: FloatArray, fit: Gaussians, target: FloatArray) -> Gaussians:
    n, d = z.shape
    share = fit.component_probabilities(z)
    size = share.sum(axis=0) + 1e-9
    weights = np.maximum(size / n, 1e-6)
    means = (share.T @ z) / size[:, None]
    prior = 0.1 * (d + 2)  # pseudo-draws with covariance `target`
    covariances = []
    for r, mean, total in zip(share.T, means, size, strict=True):
        c = z - mean
        covariances.append(((r[:, None] * c).T @ c + prior * target) / (total + prior))
    stabilised = np.stack(covariances) + 1e-5 * np.eye(d)
    return Gaussians(weights / weights.sum(), means, stabilised)
