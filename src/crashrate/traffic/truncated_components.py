"""Truncated normal components at given natural parameters, with all that a fit needs of them."""

from dataclasses import dataclass

import numpy as np

from crashrate.traffic.information import (
    feature_map,
    gaussian_information,
    link_information,
)
from crashrate.traffic.natural import expectations, gaussian_log_partition, precisions_of
from crashrate.traffic.one_dimension import COARSE, Rule, interval_moments
from crashrate.traffic.quadrature import fixed_nodes
from crashrate.traffic.tilting import Chain, chains
from crashrate.traffic.truncated_normal import chain_moments, from_chain, placed_factor
from crashrate.variables import BoolArray, FloatArray

# Standardised precisions outside these limits are a component that ran away or collapsed.
_MIN_PRECISION, _MAX_PRECISION, _MAX_CONDITION = 1e-8, 1e12, 1e12
_LOG2_POINTS = 12
_MIN_LOG_MASS = -690.0


@dataclass(frozen=True, slots=True)
class Box:
    """Sides (d,) of the truncation in the coordinates of the fit, and how finely to integrate."""

    lower: FloatArray
    upper: FloatArray
    rule: Rule = COARSE


@dataclass(frozen=True, slots=True)
class Components:
    """K truncated normals.

    Attributes
    ----------
    theta : ndarray (K, q)
        Natural parameters.
    means, covariances : ndarray (K, d), (K, d, d)
        Of the untruncated normals.
    log_masses : ndarray (K,)
        Log probability of the box under them.
    box_means, box_covariances : ndarray (K, d), (K, d, d)
        Moments on the box.
    log_partition, prior_log_partition : ndarray (K,)
        A(theta) with the truncation and A_0(theta) without.
    expected, prior_expected : ndarray (K, q)
        Gradients of the two: E s(y) on the box and on the whole space.
    information, prior_information : ndarray (K, q, q)
        Hessians of the two: Cov s(y).
    """

    theta: FloatArray
    means: FloatArray
    covariances: FloatArray
    log_masses: FloatArray
    box_means: FloatArray
    box_covariances: FloatArray
    log_partition: FloatArray
    prior_log_partition: FloatArray
    expected: FloatArray
    prior_expected: FloatArray
    information: FloatArray
    prior_information: FloatArray

    def replace(self, other: "Components", which: BoolArray) -> "Components":
        """These components with those marked in `which` (K,) taken from `other`."""
        names = self.__dataclass_fields__
        parts = {}
        for name in names:
            mine, theirs = getattr(self, name), getattr(other, name)
            mask = which.reshape(-1, *[1] * (mine.ndim - 1))
            parts[name] = np.where(mask, theirs, mine)
        return Components(**parts)


def usable(theta: FloatArray, d: int) -> BoolArray:
    """Which rows (K, q) are natural parameters of a normal that arithmetic can hold."""
    finite = np.asarray(np.isfinite(theta).all(axis=1))
    precisions = precisions_of(np.where(finite[:, None], theta, 0.0), d)
    values = np.linalg.eigvalsh(precisions)
    return np.asarray(
        finite
        & (values[:, 0] > _MIN_PRECISION)
        & (values[:, -1] < _MAX_PRECISION)
        & (values[:, -1] < _MAX_CONDITION * values[:, 0])
    )


def components_at(theta: FloatArray, box: Box) -> Components:
    """The components (K, q) in the box; `theta` must be usable."""
    d = len(box.lower)
    covariances = np.linalg.inv(precisions_of(theta, d))
    covariances = 0.5 * (covariances + covariances.transpose(0, 2, 1))
    means = np.einsum("kij,kj->ki", covariances, theta[:, :d])
    chain = chains(covariances, box.lower - means, box.upper - means)
    prior_information = gaussian_information(placed_factor(chain), means)
    prior_log_partition = gaussian_log_partition(means, covariances)
    if chain.n_bounded():
        log_masses, box_means, box_covariances, information = _on_box(chain, means, box.rule)
    else:
        log_masses, box_means, box_covariances = np.zeros(len(theta)), means, covariances
        information = prior_information
    return Components(
        theta,
        means,
        covariances,
        log_masses,
        box_means,
        box_covariances,
        prior_log_partition + log_masses,
        prior_log_partition,
        expectations(box_means, box_covariances),
        expectations(means, covariances),
        information,
        prior_information,
    )


def _on_box(
    chain: Chain, means: FloatArray, rule: Rule
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Log masses, means, covariances and information of the normals on the box."""
    nodes = fixed_nodes(chain, rule, _LOG2_POINTS)
    last = interval_moments(nodes.lower, nodes.upper, rule)
    z_mean, z_covariance = chain_moments(nodes, last)
    box_means, box_covariances = from_chain(chain, means, z_mean, z_covariance)
    mapped = feature_map(placed_factor(chain), box_means)
    information = mapped @ link_information(nodes, last, z_mean) @ mapped.transpose(0, 2, 1)
    return nodes.log_probability(), box_means, box_covariances, information


def sound(components: Components) -> BoolArray:
    """Which components (K,) came out as numbers, with some mass in the box."""
    return np.asarray(
        np.isfinite(components.expected).all(axis=1)
        & np.isfinite(components.information).all(axis=(1, 2))
        & (components.log_masses > _MIN_LOG_MASS)
    )
