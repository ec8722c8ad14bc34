"""Where a fit starts: k-means++ clusters of a part of the events."""

from dataclasses import dataclass

import numpy as np

from crashrate.traffic.tilting import IntArray
from crashrate.variables import FloatArray

_MAX_EVENTS = 15_000
_N_LLOYD = 10
_FLOOR = 1e-3  # of a standardised variance: no cluster starts flat


@dataclass(frozen=True, slots=True)
class Start:
    """Weights (K,), means (K, d) and covariances (K, d, d) in the coordinates of the fit."""

    weights: FloatArray
    means: FloatArray
    covariances: FloatArray


def k_means_start(y: FloatArray, n_components: int, rng: np.random.Generator) -> Start:
    """Moments of k-means++ clusters of standardised events (n, d)."""
    n = len(y)
    some = y[rng.choice(n, _MAX_EVENTS, replace=False)] if n > _MAX_EVENTS else y
    centres = _plus_plus(some, n_components, rng)
    for _ in range(_N_LLOYD):
        labels = _nearest(some, centres)
        for k in np.unique(labels):
            centres[k] = some[labels == k].mean(axis=0)
    return _moments(some, _nearest(some, centres), centres)


def _plus_plus(y: FloatArray, n_components: int, rng: np.random.Generator) -> FloatArray:
    """Centres, each a point drawn with probability as its squared distance to those before."""
    centres = [y[rng.integers(len(y))]]
    distance = np.full(len(y), np.inf)
    for _ in range(n_components - 1):
        distance = np.minimum(distance, ((y - centres[-1]) ** 2).sum(axis=1))
        total = distance.sum()
        chances = distance / total if total > 0.0 else np.full(len(y), 1.0 / len(y))
        centres.append(y[rng.choice(len(y), p=chances)])
    return np.array(centres)


def _nearest(y: FloatArray, centres: FloatArray) -> IntArray:
    """Index (n,) of the centre nearest to each row."""
    scores = y @ centres.T - 0.5 * (centres**2).sum(axis=1)
    return np.asarray(scores.argmax(axis=1))


def _moments(y: FloatArray, labels: IntArray, centres: FloatArray) -> Start:
    """Clusters as components; a cluster with few events takes the shape of all of them."""
    k, d = centres.shape
    means, covariances = centres.copy(), np.empty((k, d, d))
    counts = np.bincount(labels, minlength=k).astype(float)
    floor = _FLOOR * np.eye(d)
    whole = np.atleast_2d(np.cov(y.T)) + floor
    for j in range(k):
        own = y[labels == j]
        enough = len(own) > 2 * d
        covariances[j] = np.atleast_2d(np.cov(own.T)) + floor if enough else whole
    counts = np.maximum(counts, 1.0)
    return Start(counts / counts.sum(), means, covariances)
