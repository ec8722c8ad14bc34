"""Where a simulator fails: regions of failed runs, not failures here and there."""

import math

import numpy as np
from scipy.spatial import cKDTree

from crashrate.variables import BoolArray, FloatArray

# Where the nearest runs all failed, so many that failures at random had no more than this chance,
# the simulator fails; a share of failures above MOST_FAILED is taken as that.
BY_CHANCE, MOST_FAILED = 2e-3, 0.5


def fails(known: FloatArray, failed: FloatArray, u: FloatArray) -> BoolArray:
    """Where at `u` (k, m) so many failed runs are nearer than any other that it is hardly chance.

    Parameters
    ----------
    known, failed : ndarray, shapes (n, m), (j, m)
        Standardised coordinates of what is known to crash or to be safe, and of failed runs.
    u : ndarray, shape (k, m)
    """
    share = min(len(failed) / max(len(known) + len(failed), 1), MOST_FAILED)
    n = math.ceil(math.log(BY_CHANCE) / math.log(share)) if share > 0 else 1
    if len(failed) < n:
        return np.zeros(len(u), dtype=bool)
    nearest_known = cKDTree(known).query(u)[0]  # infinitely far where there is none
    return np.asarray(cKDTree(failed).query(u, k=[n])[0][:, 0] < nearest_known)
