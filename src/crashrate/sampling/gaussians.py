"""Plain Gaussian mixtures: the cheap proposals of the pool, and their fit to weighted draws."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import logsumexp

from crashrate.variables import FloatArray

EM_STEPS = 15


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
    def _inverse_chol(self) -> FloatArray:
        identity = np.eye(self.means.shape[1])
        return np.stack([solve_triangular(c, identity, lower=True) for c in self._chol])

    @cached_property
    def _log_constants(self) -> FloatArray:
        log_det = np.log(np.diagonal(self._chol, axis1=1, axis2=2)).sum(axis=1)
        constants = np.log(self.weights) - log_det
        return np.asarray(constants - 0.5 * self.means.shape[1] * math.log(2 * math.pi))

    def log_density(self, x: FloatArray) -> FloatArray:
        """Log density at `x` (n, d), shape (n,)."""
        log_density: FloatArray = logsumexp(self.log_component_densities(x), axis=1)
        return log_density

    def log_component_densities(self, x: FloatArray) -> FloatArray:
        """Log of weight × density of each component at `x` (n, d), shape (n, K)."""
        columns = []
        for mean, root, constant in zip(
            self.means, self._inverse_chol, self._log_constants, strict=True
        ):
            z = (x - mean) @ root.T
            columns.append(constant - 0.5 * np.einsum("ij,ij->i", z, z))
        return np.stack(columns, axis=1)

    def sample(self, n: int, rng: np.random.Generator) -> FloatArray:
        """`n` draws, grouped by component, shape (n, d)."""
        counts = rng.multinomial(n, self.weights)
        draws = [
            mean + rng.standard_normal((count, len(mean))) @ chol.T
            for mean, chol, count in zip(self.means, self._chol, counts, strict=True)
        ]
        return np.concatenate(draws)


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
    scale = np.where(scale > 0, scale, 1.0)
    fit = _em((x - center) / scale, n_components, rng)
    spread = np.outer(scale, scale)
    return Gaussians(fit.weights, fit.means * scale + center, fit.covariances * spread)


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
    log_parts = fit.log_component_densities(z)
    share = np.exp(log_parts - logsumexp(log_parts, axis=1, keepdims=True))
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
