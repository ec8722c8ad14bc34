"""Places far from all runs, in the units of the component of traffic that each belongs to.

A mixture may have components of very different widths. In one unit for all a component a twentieth
as wide as another counts as one point, and what crashes beyond its edge stays unseen, however much
of traffic it holds.
"""

import numpy as np
from scipy.spatial import cKDTree

from crashrate.crash_set.surrogate import IntArray
from crashrate.traffic.model import TrafficModel
from crashrate.variables import FloatArray

# Power of the density by which squared distances are weighed, for all but a third of the places: of
# regions equally far from all runs the denser holds more of traffic. Where they are not they lie at
# the rim of what is looked at, beyond that of the densest component.
DENSITY, UNWEIGHED = 0.25, 1 / 3


def farthest_locally(
    traffic: TrafficModel,
    x: FloatArray,
    runs: FloatArray,
    log_f: FloatArray,
    n: int,
    *,
    least: float = 0.0,
) -> IntArray:
    """`n` rows of `x` (N, d), each the farthest from the runs (k, d) and those chosen before it.

    Fewer, once none is farther than `least`.

    Parameters
    ----------
    traffic : TrafficModel
    x, runs : ndarray, shapes (N, d), (k, d)
    log_f : ndarray, shape (N,)
        Log density of `x`.
    n : int
    least : float
    """
    if not len(x):
        return np.empty(0, dtype=int)
    owner = traffic.log_component_densities(x).argmax(axis=1)
    scales = np.linalg.inv(np.linalg.cholesky(traffic.covariances))
    distance, chosen = np.empty(len(x)), []
    groups = [(np.flatnonzero(owner == k), scales[k].T) for k in np.unique(owner)]
    for rows, to_units in groups:
        distance[rows] = cKDTree(runs @ to_units).query(x[rows] @ to_units)[0] ** 2
    worth = np.exp(DENSITY * (log_f - log_f.max()))
    for k in range(n):
        best = int((distance if k < UNWEIGHED * n else worth * distance).argmax())
        if not (distance.max() > least**2 and distance[best] > 0):
            break
        chosen.append(best)
        for rows, to_units in groups:
            away = (x[rows] - x[best]) @ to_units
            distance[rows] = np.minimum(distance[rows], (away**2).sum(axis=1))
    return np.array(chosen, dtype=int)
