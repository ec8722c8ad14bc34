"""Normals in natural parameters: theta = (P m, P) against s(y) = (y, -y y' / 2), P = inv(C).

Theta holds P m, then P_ij for i <= j; s(y) holds y, then -y_i y_i / 2 and -y_i y_j. The log
likelihood of a (truncated) normal is concave in theta, its gradient the difference of moments.
"""

import numpy as np

from crashrate.traffic.quadratic import pair_factors, pairs
from crashrate.variables import FloatArray


def to_natural(means: FloatArray, covariances: FloatArray) -> FloatArray:
    """Means (K, d) and covariances (K, d, d) -> theta (K, d + d (d + 1) / 2)."""
    precisions = np.linalg.inv(covariances)
    i, j = pairs(means.shape[1])
    linear = np.einsum("kij,kj->ki", precisions, means)
    return np.hstack([linear, 0.5 * (precisions + precisions.transpose(0, 2, 1))[:, i, j]])


def precisions_of(theta: FloatArray, d: int) -> FloatArray:
    """The symmetric matrices P (K, d, d) in theta, definite or not."""
    i, j = pairs(d)
    precisions = np.empty((len(theta), d, d))
    precisions[:, i, j] = theta[:, d:]
    precisions[:, j, i] = theta[:, d:]
    return precisions


def gaussian_log_partition(means: FloatArray, covariances: FloatArray) -> FloatArray:
    """A_0 (K,): log of the integral of exp(theta . s(y)) over the whole space."""
    d = means.shape[1]
    solved = np.linalg.solve(covariances, means[..., None])[..., 0]
    log_determinants = np.linalg.slogdet(covariances)[1]
    quadratic = np.einsum("ki,ki->k", means, solved)
    return np.asarray(0.5 * (quadratic + log_determinants + d * np.log(2.0 * np.pi)))


def expectations(means: FloatArray, covariances: FloatArray) -> FloatArray:
    """E s(y) (K, q) of any law with these means (K, d) and covariances (K, d, d)."""
    d = means.shape[1]
    i, j = pairs(d)
    second = covariances + means[:, :, None] * means[:, None, :]
    return np.hstack([means, second[:, i, j] * pair_factors(d)])
