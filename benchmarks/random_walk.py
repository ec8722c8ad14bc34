"""Probability that a Gaussian random walk crosses a level, by quadrature."""

import numpy as np
from numpy.polynomial.legendre import leggauss
from scipy.special import ndtr

N_NODES = 400


def crossing_probability(level: float, steps: int, n_nodes: int = N_NODES) -> float:
    """P(max over k ≤ `steps` of z_1 + … + z_k ≥ `level`) of standard normal z.

    The law of a walk that has not crossed is carried from step to step by Gauss-Legendre
    quadrature on [-L, level], and what crosses is added up: no difference of near-equal numbers,
    so the accuracy is relative. Below -L no walk comes that crosses: L is `level` + 12 √steps
    under the level, and a walk from there would have to climb further than that.
    """
    low = -12 * np.sqrt(steps)
    t, w = leggauss(n_nodes)
    y = low + (level - low) * (t + 1) / 2
    w = w * (level - low) / 2
    density = _normal(y)  # after the first step, of walks below the level
    crossed = float(ndtr(-level))
    kernel = _normal(y[:, None] - y)
    for _ in range(steps - 1):
        crossed += float(w @ (density * ndtr(y - level)))
        density = kernel @ (w * density)
    return crossed


def _normal(z: np.ndarray) -> np.ndarray:
    return np.asarray(np.exp(-z * z / 2) / np.sqrt(2 * np.pi))
