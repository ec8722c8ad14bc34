"""Gaussian mixtures near the density of traffic given a crash, from weighted crashes."""

import math

import numpy as np

from crashrate.sampling.gaussians import Gaussians, fit_gaussians
from crashrate.traffic.model import TrafficModel
from crashrate.variables import FloatArray

SHARP = 60.0  # equally weighted crashes that the smoothed weights leave, where there are as many
BROAD = 0.5  # of the crashes' number: at most as many, and the broad mixture's
PER_COMPONENT = 4  # crashes for each component and each parameter of its mean
MAX_COMPONENTS = 8
HALVINGS = 30
# shares of the fitted components with their covariances times a factor: a fit to few crashes is
# too narrow, and weights outside it too large
WIDENED = ((0.5, 1.3), (0.3, 3.0), (0.2, 9.0))


def n_eff(log_weights: FloatArray) -> float:
    """Number of equal weights that would be as good: (Σ w)² / Σ w²; 0 without any."""
    if not len(log_weights):
        return 0.0
    w = np.exp(log_weights - log_weights.max())
    return float(w.sum() ** 2 / (w @ w))


def smoothed(log_weights: FloatArray, wanted: float) -> FloatArray:
    """α log w (k,) with the largest α up to 1 that leaves `wanted` equal weights.

    As long as most crashes are far beyond the likely ones, the weights themselves hang on one or
    two of them.
    """
    if n_eff(log_weights) >= wanted:
        return log_weights
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if n_eff(middle * log_weights) >= wanted else (low, middle)
    return low * log_weights


def sharp(
    traffic: TrafficModel, x: FloatArray, log_weights: FloatArray, rng: np.random.Generator
) -> Gaussians:
    """The mixture that weighted crashes suggest, with wide flanks.

    Parameters
    ----------
    traffic : TrafficModel
        Its components' mean covariance is that of the kernels, where crashes are too few to fit.
    x : ndarray, shape (k, d)
        Crashes; at least one.
    log_weights : ndarray, shape (k,)
        log f/q, up to a constant.
    rng : Generator
    """
    fit = _fit(traffic, x, smoothed(log_weights, min(SHARP, BROAD * len(x))), rng)
    return Gaussians(
        np.concatenate([share * fit.weights for share, _ in WIDENED]),
        np.concatenate([fit.means for _ in WIDENED]),
        np.concatenate([factor * fit.covariances for _, factor in WIDENED]),
    )


def broad(
    traffic: TrafficModel, x: FloatArray, log_weights: FloatArray, rng: np.random.Generator
) -> Gaussians:
    """A mixture that covers half of the crashes, however unlikely; parameters as of `sharp`.

    A crash region of which only unlikely crashes are known has hardly a say in the weights.
    """
    return _fit(traffic, x, smoothed(log_weights, BROAD * len(x)), rng)


def _fit(
    traffic: TrafficModel, x: FloatArray, log_weights: FloatArray, rng: np.random.Generator
) -> Gaussians:
    n_components = math.floor(n_eff(log_weights) / (PER_COMPONENT * (x.shape[1] + 1)))
    weights = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()
    if not n_components:
        kernel = np.einsum("k,kij->ij", traffic.weights, traffic.covariances)
        return Gaussians(weights, x, np.repeat(kernel[None], len(x), axis=0))
    # repeated rows stand for weights, and no more rows than crashes: shrinkage counts them
    ticks = (rng.random() + np.arange(len(x))) / len(x)
    rows = np.minimum(np.searchsorted(np.cumsum(weights), ticks), len(x) - 1)
    return fit_gaussians(x[rows], min(n_components, MAX_COMPONENTS), rng)
