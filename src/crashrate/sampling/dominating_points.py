"""Dominating points: where a Gaussian component is densest in a convex set (§IV.B, 2017 paper)."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from crashrate.errors import InvalidInputError, NumericalError
from crashrate.sampling.active_set import LeastNorm, least_norm
from crashrate.variables import FloatArray

# of the Karush–Kuhn–Tucker conditions, in standard deviations relative to 1 + distance
KKT_TOLERANCE = 1e-8


class Whitening(NamedTuple):
    """x = mean + factor @ z, so that a component's squared distance is |z|²."""

    mean: FloatArray
    factor: FloatArray

    @classmethod
    def of(cls, mean: FloatArray, covariance: FloatArray) -> "Whitening":
        """The one with a lower triangular factor.

        Raises
        ------
        InvalidInputError
            If the covariance is not positive definite.
        """
        try:
            return cls(mean, np.asarray(np.linalg.cholesky(covariance), np.float64))
        except np.linalg.LinAlgError:
            raise InvalidInputError(
                "covariance: expected a positive definite matrix, got eigenvalues "
                f"{np.linalg.eigvalsh(covariance)}."
            ) from None

    def dominating_point(self, normals: FloatArray, offsets: FloatArray) -> FloatArray | None:
        """As the function of that name, without looking at its arguments again."""
        slopes = normals @ self.factor
        lengths = np.sqrt((slopes * slopes).sum(axis=1))
        offsets = offsets - normals @ self.mean
        flat = lengths == 0.0
        if (offsets[flat] > 0.0).any():
            return None
        slopes, offsets = slopes[~flat] / lengths[~flat, None], offsets[~flat] / lengths[~flat]
        found = least_norm(slopes, offsets)
        if found is None:
            return None
        _require_kkt(found, slopes, offsets)
        return self.mean + self.factor @ found.z


def dominating_point(
    mean: npt.ArrayLike,
    covariance: npt.ArrayLike,
    normals: npt.ArrayLike,
    offsets: npt.ArrayLike,
) -> FloatArray | None:
    """The densest point of a Gaussian in a polyhedron: eq. max φ(x; µ, Σ) s.t. x in the set.

    argmin (x - mean)' Σ⁻¹ (x - mean) subject to normals @ x >= offsets, exactly, in any dimension:
    the problem is whitened with a Cholesky factor and solved by an active-set method, and the
    answer is checked against the Karush–Kuhn–Tucker conditions, which are sufficient here.

    Parameters
    ----------
    mean : (d,) array
    covariance : (d, d) array
        Positive definite.
    normals : (c, d) array
    offsets : (c,) array
        -inf where there is no constraint.

    Returns
    -------
    (d,) array or None
        None where the polyhedron is empty.

    Raises
    ------
    InvalidInputError
        If the shapes do not match, the covariance is not positive definite, or a number is NaN.
    NumericalError
        If the answer misses the Karush–Kuhn–Tucker conditions.
    """
    m, s = np.asarray(mean, np.float64), np.asarray(covariance, np.float64)
    a, b = np.asarray(normals, np.float64), np.asarray(offsets, np.float64)
    d = m.size
    if m.shape != (d,) or s.shape != (d, d) or a.shape != (b.size, d) or b.shape != (b.size,):
        raise InvalidInputError(
            "dominating_point: expected mean (d,), covariance (d, d), normals (c, d) and offsets "
            f"(c,), got {m.shape}, {s.shape}, {a.shape} and {b.shape}."
        )
    if np.isnan(b).any() or not all(np.isfinite(v).all() for v in (m, s, a)):
        raise InvalidInputError("dominating_point: expected numbers, finite except for offsets.")
    if (b == np.inf).any():
        return None
    real = b > -np.inf
    return Whitening.of(m, s).dominating_point(a[real], b[real])


def kkt_residual(found: LeastNorm, normals: FloatArray, offsets: FloatArray) -> float:
    """How far a least-norm point misses its optimality conditions.

    The largest of: distance outside a half-space, |z - normals.T @ λ|, -λ, and |λ · slack|
    (relative to λ's size), over 1 + |z|.
    """
    z, multipliers = found
    slack = normals @ z - offsets
    price = 1.0 + np.abs(multipliers).max(initial=0.0)
    misses = (
        (-slack).max(initial=0.0),
        np.abs(z - normals.T @ multipliers).max(initial=0.0),
        (-multipliers).max(initial=0.0) / price * (1.0 + np.abs(z).max(initial=0.0)),
        np.abs(multipliers * slack).max(initial=0.0) / price,
    )
    return float(max(misses) / (1.0 + np.linalg.norm(z)))


def _require_kkt(found: LeastNorm, normals: FloatArray, offsets: FloatArray) -> None:
    residual = kkt_residual(found, normals, offsets)
    if not residual <= KKT_TOLERANCE:
        raise NumericalError(
            f"dominating point: the optimality conditions are missed by {residual:.1e} "
            f"(allowed {KKT_TOLERANCE:.0e}); the constraints are nearly dependent."
        )
