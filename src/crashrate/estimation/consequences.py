"""What a run that ends in the event is expected to do: consequences, learned from those so far.

g(x) = E[z | event, x] of a consequence z in [0, 1] is learned from the runs with the event, by a
classifier where all values are 0 or 1, else by a regression. It sees the surrogate's coordinates
and the surrogate's danger: how deep a situation lies in the crash set is what consequences depend
on most. Like the surrogate, it steers and predicts; the rounds correct it (`carried`).
"""

import numpy as np

from crashrate.crash_set.regression import regress
from crashrate.crash_set.surrogate import Prior, Surrogate, fit_surrogate
from crashrate.estimation.labels import Labels
from crashrate.estimation.view import Moments, Standardiser, View, normalised
from crashrate.variables import BoolArray, FloatArray

MAX_EVENTS = 300  # the latest: the cost of learning grows with the cube
LIKELY = 1e-3  # where the event is less likely, the average of all consequences will do
DOUBT = 1e-3  # no consequence is held for certain, nor impossible
MIN_EACH = 2  # of both values, for a classifier to learn where one passes into the other
# bump, length and variance of the classifiers: from outcomes left to chance to a sharp edge
CLASSIFIERS = (
    (0.1, 3.0, 1.0),
    (0.1, 3.0, 10.0),
    (0.1, 3.0, 100.0),
    (0.1, 3.0, 1e3),
    (1.0, 1.5, 10.0),
    (1.0, 1.5, 1e3),
)
DEPTHS, REACHES = (0.5, 2.0), (1.5, 5.0)  # lengths of the regression, in danger and coordinates


def expect(
    view: View, labels: Labels, surrogate: Surrogate, standardise: Standardiser
) -> tuple[Moments, ...]:
    """Moments of each consequence at the draws of `view`."""
    events = np.flatnonzero(labels.y == 1)[-MAX_EVENTS:]
    near = np.flatnonzero(view.h > LIKELY)
    if not len(near):
        return tuple(_moments(view, *_constant(z)) for z in labels.z[events].T)
    seen, asked = (standardise(u) for u in (labels.u[events], view.pool.u[near]))
    depth = surrogate.predict(asked).danger
    likely = normalised((view.weights * view.h)[near])
    scale = float(np.sqrt(likely @ depth**2)) + 1e-6  # of the events that traffic brings
    seen = _with(seen, surrogate.predict(seen).danger / scale)
    asked = _with(asked, depth / scale)
    found = []
    for z in labels.z[events].T:
        mean, noise = (np.full(len(view.h), v) for v in _constant(z))
        mean[near], noise[near] = _learned(seen, z, asked)
        found.append(_moments(view, mean, noise))
    return tuple(found)


def _with(u: FloatArray, depth: FloatArray) -> FloatArray:
    """Coordinates (n, m) and depth (n,); what lies far in the crash set differs by little more."""
    return np.column_stack([u, np.arcsinh(depth)])


def _moments(view: View, mean: FloatArray | float, noise: FloatArray | float) -> Moments:
    """Of z, which is 0 without the event: h g and h (g² + s²)."""
    g = np.clip(mean, DOUBT, 1 - DOUBT)
    most = g * (1 - g)  # no number in [0, 1] of mean g varies more
    s2 = np.clip(noise, DOUBT * most, most)
    return Moments(view.h * g, view.h * (g * g + s2))


def _constant(z: FloatArray) -> tuple[float, float]:
    """Mean and variance where nothing is known but values (n,), as if one of 0.5 had been seen."""
    g = (float(z.sum()) + 0.5) / (len(z) + 1)
    return g, g * (1 - g)


def _learned(seen: FloatArray, z: FloatArray, asked: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and variance of z at features `asked` (k, m), from values z (n,) at `seen` (n, m)."""
    if np.all((z == 0) | (z == 1)):
        mean = _classified(seen, z == 1, asked)
        return mean, mean * (1 - mean)
    m = seen.shape[1] - 1
    lengths = tuple(
        np.append(np.full(m, reach * np.sqrt(m / 3)), depth)
        for reach in REACHES
        for depth in DEPTHS
    )
    return regress(seen, z, lengths).predict(asked)


def _classified(seen: FloatArray, carried: BoolArray, asked: FloatArray) -> FloatArray:
    """P(z = 1) at `asked` (k,); the share seen where no classifier foretells the values better."""
    n, n_1 = len(carried), int(carried.sum())
    mean, _ = _constant(carried.astype(float))
    if min(n_1, n - n_1) < MIN_EACH:
        return np.full(len(asked), mean)
    fits = [fit_surrogate(seen, carried, _prior(*c, m=seen.shape[1])) for c in CLASSIFIERS]
    best = max(fits, key=lambda fit: (fit.converged, fit.log_score))
    # each value foretold by the others alone, as the classifiers' scores are
    alone = (n_1 - carried + 0.5) / n
    score = float(np.log(np.where(carried, alone, 1 - alone)).sum())
    if score > best.log_score:
        return np.full(len(asked), mean)
    return best.predict(asked).probability


def _prior(bump: float, length: float, variance: float, *, m: int) -> Prior:
    length *= float(np.sqrt(m / 3))
    return Prior(bump, length, variance, linear=1.0, slope=0.0, constant=0.0)
