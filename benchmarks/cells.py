"""A half-plane with holes: which cells of a grid are safe, and the probability that is left.

Cells are safe by a hash of their indices, outcomes random by a hash of the situation: the same on
every machine, in any order and batch, which a generator's state is not.
"""

import numpy as np
import numpy.typing as npt
from numpy.polynomial.legendre import leggauss
from scipy.special import ndtr

Floats = npt.NDArray[np.float64]
Words = npt.NDArray[np.uint64]
SIDE = 0.05
N_NODES = 8  # a cell and half a cell are nearly polynomials: relative error below 1e-12
REACH = 9.0  # of each coordinate about the likeliest crash: 2e-19 of a normal is beyond


def uniform(words: npt.ArrayLike, seed: int = 0) -> Floats:
    """Numbers in [0, 1) that look independent of one another, one for each row of 64-bit words.

    The finaliser of SplitMix64 (Steele, Lea, Flood 2014), over the row's words in turn.

    Parameters
    ----------
    words : array_like of int64, uint64 or float64, shape (n, m)
        Of a float its bits count.
    """
    rows = np.ascontiguousarray(words).view(np.uint64)
    state = np.full(len(rows), seed, dtype=np.uint64)
    for column in rows.T:
        state = _mixed((state ^ column) + np.uint64(0x9E3779B97F4A7C15))
    return np.asarray((state >> np.uint64(11)) * 2.0**-53)


def _mixed(z: Words) -> Words:
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


def in_hole(x: Floats, share: float) -> npt.NDArray[np.bool_]:
    """Whether `x` (n, 2) lies in one of the cells that are holes, (n,)."""
    return uniform(np.floor(x / SIDE).astype(np.int64)) < share


def probability_with_holes(level: float, share: float) -> float:
    """P(x1 + x2 ≥ `level`, outside the holes) of two standard normals.

    Cell by cell, with the second coordinate integrated exactly and the first by Gauss-Legendre
    quadrature. In every column of cells the half-plane's edge passes from one cell to the next at
    the same place, and there the integrand has a kink: each column is cut in two at it. What is
    farther than `REACH` from the likeliest crash, in a coordinate, is held to be without holes.
    """
    first = np.floor((level / 2 - REACH) / SIDE)
    index = first + np.arange(int(2 * REACH / SIDE) + 1)
    i, j = np.meshgrid(index, index, indexing="ij")
    holes = in_hole((np.column_stack([i.ravel(), j.ravel()]) + 0.5) * SIDE, share)
    i, j = i.ravel()[holes], j.ravel()[holes]
    kink = level % SIDE
    lost = _in_columns(level, i, j, 0.0, kink) + _in_columns(level, i, j, kink, SIDE)
    return float(ndtr(-level / np.sqrt(2)) - lost.sum())


def _in_columns(level: float, i: Floats, j: Floats, start: float, end: float) -> Floats:
    """P(half-plane and cell (i, j)), of the cell's part from `start` to `end`, (n,)."""
    t, w = leggauss(N_NODES)
    y = i[:, None] * SIDE + start + (end - start) * (t + 1) / 2
    low = np.maximum(j[:, None] * SIDE, level - y)
    high = np.maximum((j[:, None] + 1) * SIDE, low)
    inner = ndtr(-low) - ndtr(-high)
    density = np.exp(-y * y / 2) / np.sqrt(2 * np.pi)
    return np.asarray((density * inner) @ w * (end - start) / 2)
