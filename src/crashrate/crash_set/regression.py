"""A number learned from few noisy values: Gaussian-process regression with a plane and a bump.

The scale of the process is integrated out and its other parameters are chosen by the marginal
likelihood (Rasmussen & Williams 2006, §5.4) over a small grid, so that the fit is deterministic.
One eigendecomposition for each pair of lengths serves all noises.
"""

import math
from dataclasses import dataclass

import numpy as np

from crashrate.variables import FloatArray

PLANE = 1.0  # prior variance of constant and slopes, over that of the bump
NOISES = (1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0)  # variance over that of the bump
# The scale's inverse-gamma prior: as if this many values had been seen with this variance. Values
# that are all equal so far may still come to differ.
PRIOR_VALUES, PRIOR_VARIANCE = 2.0, 0.02


@dataclass(frozen=True, slots=True)
class Regression:
    """A fitted regression.

    Parameters
    ----------
    points : ndarray, shape (n, m)
        Where values are known, over the lengths of each coordinate.
    lengths : ndarray, shape (m,)
        Of the bump, in each coordinate.
    center : float
        Mean of the values.
    variance, noise : float
        Of the bump, and of a value over that of the bump.
    inverse : ndarray, shape (n, n)
        Of the values' covariance over `variance`.
    coefficients : ndarray, shape (n,)
        Of the mean.
    log_likelihood : float
        Marginal, up to a constant: chooses among lengths and noises.
    """

    points: FloatArray
    lengths: FloatArray
    center: float
    variance: float
    noise: float
    inverse: FloatArray
    coefficients: FloatArray
    log_likelihood: float

    def predict(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and variance (n,) of a value at `u` (n, m), its noise included."""
        v = u / self.lengths
        k = covariance(u, v, self.points * self.lengths, self.points)
        prior = 1 + PLANE * (1 + (u**2).sum(axis=1)) + self.noise
        explained = np.einsum("ij,ij->i", k @ self.inverse, k)
        variance = self.variance * np.maximum(prior - explained, self.noise)
        return self.center + k @ self.coefficients, variance


def covariance(u: FloatArray, v: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    """Prior covariance (n, k) of points `u` (n, m) and `a` (k, m); `v`, `b`: over the lengths."""
    squares = (v**2).sum(axis=1)[:, None] + (b**2).sum(axis=1) - 2 * v @ b.T
    return np.asarray(PLANE * (1 + u @ a.T) + np.exp(-np.maximum(squares, 0.0) / 2))


def regress(u: FloatArray, values: FloatArray, candidates: tuple[FloatArray, ...]) -> Regression:
    """The regression of `values` (n,) at `u` (n, m) with the likeliest noise and lengths.

    Parameters
    ----------
    candidates : tuple of ndarray, shape (m,)
        Lengths to choose from.
    """
    fits = [_best_noise(u, values, lengths) for lengths in candidates]
    return max(fits, key=lambda fit: fit.log_likelihood)


def _best_noise(u: FloatArray, values: FloatArray, lengths: FloatArray) -> Regression:
    n, center, v = len(u), float(values.mean()), u / lengths
    eigenvalues, vectors = np.linalg.eigh(covariance(u, v, u, v))
    rotated = vectors.T @ (values - center)
    found = []
    for noise in NOISES:
        spectrum = np.maximum(eigenvalues, 0.0) + noise
        squares = float(rotated**2 @ (1 / spectrum)) + PRIOR_VALUES * PRIOR_VARIANCE
        scale = squares / (n + PRIOR_VALUES)
        likelihood = -0.5 * ((n + PRIOR_VALUES) * math.log(scale) + float(np.log(spectrum).sum()))
        found.append((likelihood, noise, scale, spectrum))
    likelihood, noise, scale, spectrum = max(found, key=lambda f: f[0])
    inverse = (vectors / spectrum) @ vectors.T
    return Regression(
        points=v,
        lengths=lengths,
        center=center,
        variance=scale,
        noise=noise,
        inverse=inverse,
        coefficients=vectors @ (rotated / spectrum),
        log_likelihood=likelihood,
    )
