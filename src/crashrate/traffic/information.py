"""The information of a truncated normal about its natural parameters: Cov s(y), exactly."""

import numpy as np

from crashrate.traffic.one_dimension import IntervalMoments
from crashrate.traffic.quadratic import pair_factors, pairs
from crashrate.traffic.quadrature import Nodes
from crashrate.variables import FloatArray


def feature_map(factors: FloatArray, means: FloatArray) -> FloatArray:
    """The matrices J (K, q, q) with s(y) = J (t, t t') + constant for y = mean + factor t."""
    k, d = means.shape
    i, j = pairs(d)
    out = np.zeros((k, d + len(i), d + len(i)))
    out[:, :d, :d] = factors
    row_i, row_j = factors[:, i], factors[:, j]  # (K, pairs, d)
    out[:, d:, :d] = means[:, i, None] * row_j + means[:, j, None] * row_i
    both = row_i[:, :, i] * row_j[:, :, j] + row_i[:, :, j] * row_j[:, :, i]
    out[:, d:, d:] = np.where(i == j, 0.5, 1.0) * both
    out[:, d:] *= pair_factors(d)[:, None]
    return out


def gaussian_information(factors: FloatArray, means: FloatArray) -> FloatArray:
    """Cov s(y) (K, q, q) of untruncated normals with Cholesky factors (K, d, d)."""
    d = means.shape[1]
    i, j = pairs(d)
    variances = np.concatenate([np.ones(d), np.where(i == j, 2.0, 1.0)])
    mapped = feature_map(factors, means)
    return np.asarray((mapped * variances) @ mapped.transpose(0, 2, 1))


def link_information(nodes: Nodes, last: IntervalMoments, z_mean: FloatArray) -> FloatArray:
    """Cov (t, t t') (K, q, q) of the links t = z - z_mean, by the law of total covariance.

    Given a node only the last link is random; both terms are sums of squares, so nothing cancels.
    """
    shares = nodes.shares()
    t = np.concatenate([nodes.points, last.mean[..., None]], axis=2) - z_mean[:, None, :]
    d = t.shape[2]
    i, j = pairs(d)
    features = np.concatenate([t, t[:, :, i] * t[:, :, j]], axis=2)
    features[:, :, -1] += last.second  # E t_d^2 given the node
    features -= np.einsum("bn,bnq->bq", shares, features)[:, None, :]
    between = (features * shares[..., None]).transpose(0, 2, 1) @ features
    # Given the node, (t_d, t_d^2) has covariance [[v, c], [c, f]].
    m, v = t[:, :, -1], last.second
    c = last.third + 2.0 * m * v
    f = last.fourth - v * v + 4.0 * m * last.third + 4.0 * m * m * v
    slope = np.zeros_like(features)  # of each feature in t_d
    slope[:, :, d - 1] = 1.0
    slope[:, :, d:] = np.where(j == d - 1, t[:, :, i], 0.0)
    slope[:, :, -1] = c / v
    within = (slope * (shares * v)[..., None]).transpose(0, 2, 1) @ slope
    within[:, -1, -1] += (shares * np.maximum(f - c * c / v, 0.0)).sum(axis=1)
    return np.asarray(between + within)
