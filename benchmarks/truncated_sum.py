"""Probability that the sum of two independent truncated normals exceeds a level, by quadrature."""

from collections.abc import Sequence

import numpy as np
from numpy.polynomial.legendre import leggauss
from scipy.special import ndtr

N_NODES = 200


def sum_probability(
    level: float, means: Sequence[float], deviations: Sequence[float], n_nodes: int = N_NODES
) -> float:
    """P(x1 + x2 ≥ `level` | x1, x2 ≥ 0) of independent normals x1 and x2, `level` > 0.

    With x1 below the level it is integrated by Gauss-Legendre quadrature, with x1 above it every x2
    will do. All terms are positive, so the accuracy is relative.
    """
    (m1, m2), (s1, s2) = means, deviations
    t, w = leggauss(n_nodes)
    y = level * (t + 1) / 2
    density = np.exp(-(((y - m1) / s1) ** 2) / 2) / (s1 * np.sqrt(2 * np.pi))
    below = float((density * ndtr((m2 - (level - y)) / s2)) @ w * level / 2)
    above = float(ndtr((m1 - level) / s1) * ndtr(m2 / s2))
    return (below + above) / float(ndtr(m1 / s1) * ndtr(m2 / s2))
