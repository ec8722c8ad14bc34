"""Log normal densities as one matrix product: they are linear in (1, y, y y').

A block of rows becomes a feature matrix, K components a coefficient matrix, and the K log
densities of every row their product; blocks keep it in the cache and never hold N x K numbers.
"""

from collections.abc import Iterator
from functools import cache

import numpy as np
import numpy.typing as npt

from crashrate.variables import FloatArray, frozen

BLOCK = 4096


@cache
def pairs(d: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Indices i and j of the pairs i <= j, made once: a fit asks for them at every step."""
    i, j = np.triu_indices(d)
    return frozen(i, np.int64), frozen(j, np.int64)


def n_features(d: int) -> int:
    """1 + d + d (d + 1) / 2."""
    return 1 + d + d * (d + 1) // 2


def features(y: FloatArray) -> FloatArray:
    """Rows (n, d) -> features (n_features, n): 1, y, then y_i y_j for i <= j."""
    n, d = y.shape
    out = np.empty((n_features(d), n))
    out[0] = 1.0
    out[1 : d + 1] = y.T
    i, j = pairs(d)
    np.multiply(out[1 + i], out[1 + j], out=out[d + 1 :])
    return out


def pair_factors(d: int) -> FloatArray:
    """The factor of y_i y_j in -y' P y / 2, per entry P_ij: -1/2 on the diagonal, else -1."""
    i, j = pairs(d)
    return np.where(i == j, -0.5, -1.0)


def blocks(n: int) -> Iterator[slice]:
    """Slices that cover n rows."""
    for start in range(0, n, BLOCK):
        yield slice(start, min(start + BLOCK, n))


def log_sum(terms: FloatArray) -> FloatArray:
    """log sum exp (n,) over the first axis; `terms` (K, n) becomes each one's share of the sum."""
    top = terms.max(axis=0)
    terms -= top
    np.exp(terms, out=terms)
    total = terms.sum(axis=0)
    terms *= 1.0 / total
    return np.asarray(top + np.log(total))
