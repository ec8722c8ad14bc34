"""Pareto fronts: minimal and maximal points of the componentwise order.

"Above" and "below" are weak: a point is above itself.
"""

import numpy as np

from crashrate.variables import BoolArray, FloatArray

# comparisons held at once: they stay in the cache of one core
_BLOCK = 1 << 18


def above_any(u: FloatArray, front: FloatArray) -> BoolArray:
    """Which rows of u (n, m) are >= some row of `front` (k, m) in every column: (n,)."""
    out = np.zeros(len(u), dtype=np.bool_)
    if not len(front):
        return out
    columns = np.ascontiguousarray(u.T)
    step = max(1, _BLOCK // len(front))
    for start in range(0, len(u), step):
        block = columns[:, start : start + step]
        above = block[0] >= front[:, :1]
        for k in range(1, len(block)):
            above &= block[k] >= front[:, k : k + 1]
        above.any(axis=0, out=out[start : start + step])
    return out


def below_any(u: FloatArray, front: FloatArray) -> BoolArray:
    """Which rows of u (n, m) are <= some row of `front` (k, m) in every column: (n,)."""
    return above_any(-u, -front)


def insert_minimal(front: FloatArray, point: FloatArray) -> FloatArray:
    """The minimal points of `front` (k, m), itself minimal, and one more `point` (m,)."""
    if (front <= point).all(axis=1).any():
        return front
    return np.vstack([front[~(front >= point).all(axis=1)], point])


def insert_maximal(front: FloatArray, point: FloatArray) -> FloatArray:
    """The maximal points of `front` (k, m), itself maximal, and one more `point` (m,)."""
    if (front >= point).all(axis=1).any():
        return front
    return np.vstack([front[~(front <= point).all(axis=1)], point])


def minimal(points: FloatArray) -> FloatArray:
    """The minimal rows of `points` (n, m), without repetition, in lexicographic order."""
    # after a lexicographic sort nothing later can be below something earlier
    rows = np.unique(points, axis=0)
    kept = rows[:0]
    while len(rows):
        kept = np.vstack([kept, rows[:1]])
        rows = rows[~(rows >= rows[0]).all(axis=1)]
    return kept


def maximal(points: FloatArray) -> FloatArray:
    """The maximal rows of `points` (n, m), without repetition."""
    return -minimal(-points)
