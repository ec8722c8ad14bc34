"""Which labels a surrogate is fitted to where there are too many: those that hold the edge."""

import numpy as np
from scipy.spatial import cKDTree

from crashrate.crash_set.surrogate import IntArray
from crashrate.variables import BoolArray, FloatArray

# The surrogate's cost grows with the cube of its labels. Of more than MAX_LABELS it keeps the new
# ones and those of the others that hold the edge in place, at least MIN_OLD of them.
MAX_LABELS, MIN_OLD = 700, 350


def telling(u: FloatArray, crash: BoolArray, tau: FloatArray) -> IntArray:
    """Rows of the labels to fit, in order: all where there are few.

    A label far from the edge has a site of next to no precision: the fit is as good without.

    Parameters
    ----------
    u : ndarray, shape (n, m)
        Standardised risk coordinates.
    crash : ndarray of bool, shape (n,)
    tau : ndarray, shape (n,)
        Precisions of the labels' sites, NaN for the new ones.
    """
    if len(u) <= MAX_LABELS:
        return np.arange(len(u))
    new, old = np.flatnonzero(np.isnan(tau)), np.flatnonzero(~np.isnan(tau))
    new = _nearest_and_even(u, crash, new, MAX_LABELS - min(MIN_OLD, len(old)))
    sharpest = np.argsort(-tau[old], kind="stable")[: MAX_LABELS - len(new)]
    return np.sort(np.concatenate([new, old[sharpest]]))


def _nearest_and_even(u: FloatArray, crash: BoolArray, rows: IntArray, n: int) -> IntArray:
    """Up to `n` of `rows`: half nearest to the other outcome, half of the rest evenly in time.

    Of thousands of outcomes that come at once (a first crash after as many random encounters)
    nothing else is known.
    """
    if len(rows) <= n:
        return rows
    distance = np.full(len(u), np.inf)
    for side in (crash, ~crash):
        if side.any() and not side.all():
            distance[side] = cKDTree(u[~side]).query(u[side])[0]
    by_distance = rows[np.argsort(distance[rows], kind="stable")]
    nearest, rest = by_distance[: n - n // 2], np.sort(by_distance[n - n // 2 :])
    even = rest[np.linspace(0, len(rest) - 1, n // 2).round().astype(int)]
    return np.concatenate([nearest, even])
