"""Where a truncated normal has its mass: Botev's minimax exponential tilting.

A normal x = mean + L z on a box is a chain of one-dimensional problems: given the earlier z, the
next one is standard normal on an interval. Shifting each link by the tilt of a saddle point
bounds the likelihood ratio of the chain by its value there [1]_.

References
----------
.. [1] Z. I. Botev, "The normal law under linear restrictions: simulation and estimation via
   minimax tilting", Journal of the Royal Statistical Society B 79 (2017) 125-148.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from crashrate.errors import NumericalError
from crashrate.traffic.one_dimension import interval_moments, log_interval_probability
from crashrate.variables import BoolArray, FloatArray

IntArray = npt.NDArray[np.int64]

_TOLERANCE = 1e-9
_MAX_NEWTON = 100
_MAX_HALVINGS = 30


@dataclass(frozen=True, slots=True)
class Chain:
    """B truncated normals as chains of standard normals on intervals.

    Link i given the earlier ones is standard normal on
    [lower_i - coupling_i z, upper_i - coupling_i z].

    Attributes
    ----------
    order : ndarray (B, d)
        Which variable each link is; the most constrained one comes first.
    factor : ndarray (B, d, d)
        Lower Cholesky factor of the covariance in that order.
    coupling : ndarray (B, d, d)
        factor with rows divided by the diagonal, less the identity.
    lower, upper : ndarray (B, d)
        Limits less the mean, in that order, over the diagonal of the factor.
    """

    order: IntArray
    factor: FloatArray
    coupling: FloatArray
    lower: FloatArray
    upper: FloatArray

    @property
    def shape(self) -> tuple[int, int]:
        """(B, d)."""
        n_boxes, n_variables = self.lower.shape
        return n_boxes, n_variables

    def head(self, n: int) -> "Chain":
        """The chain of the first n links: a truncated normal of its own."""
        return Chain(
            self.order[:, :n],
            self.factor[:, :n, :n],
            self.coupling[:, :n, :n],
            self.lower[:, :n],
            self.upper[:, :n],
        )

    def take(self, boxes: IntArray) -> "Chain":
        """The chains of some boxes."""
        return Chain(
            self.order[boxes],
            self.factor[boxes],
            self.coupling[boxes],
            self.lower[boxes],
            self.upper[boxes],
        )

    def n_bounded(self) -> int:
        """How many links, at most, have a finite limit; the free ones stand last."""
        bounded = np.isfinite(self.lower) | np.isfinite(self.upper)
        return int(bounded.any(axis=0).sum())


@dataclass(frozen=True, slots=True)
class Tilting:
    """The saddle point of the log likelihood ratio psi(z, tilt) of B chains.

    Attributes
    ----------
    tilt, point : ndarray (B, d)
        The shift of each link and the z of the saddle point; the last link is not shifted.
    log_bound : ndarray (B,)
        psi at the saddle point: an upper bound of the log probability of the box.
    residual : ndarray (B,)
        Largest absolute derivative of psi there.
    """

    tilt: FloatArray
    point: FloatArray
    log_bound: FloatArray
    residual: FloatArray

    def take(self, boxes: IntArray) -> "Tilting":
        """The saddle points of some chains."""
        return Tilting(
            self.tilt[boxes], self.point[boxes], self.log_bound[boxes], self.residual[boxes]
        )


def chains(covariances: FloatArray, lower: FloatArray, upper: FloatArray) -> Chain:
    """Chains of zero-mean normals (B, d, d) on boxes (B, d), most constrained variable first.

    The order is that of Gibson, Glasbey and Elston (1994): each link is the variable whose
    interval is least likely given the expected values of the links before it.

    Raises
    ------
    NumericalError
        If a covariance is not numerically positive definite.
    """
    n_boxes, d = lower.shape
    order = np.tile(np.arange(d), (n_boxes, 1))
    covariances, low, high = covariances.copy(), lower.copy(), upper.copy()
    factor = np.zeros((n_boxes, d, d))
    expected = np.zeros((n_boxes, d))
    for j in range(d):
        past = factor[:, j:, :j]
        variance = np.diagonal(covariances, axis1=1, axis2=2)[:, j:] - (past**2).sum(axis=2)
        if not (variance > 0.0).all():
            raise NumericalError(
                f"covariance {int(np.argmin(variance.min(axis=1)))}: expected a positive definite "
                "matrix, got one that is singular to working precision; drop or rescale a "
                "variable that the others determine."
            )
        deviation = np.sqrt(variance)
        shift = np.einsum("bij,bj->bi", past, expected[:, :j])
        pick = j + _least_likely(
            (low[:, j:] - shift) / deviation, (high[:, j:] - shift) / deviation
        )
        _swap_links(j, pick, (order, low, high, factor, covariances))
        _swap_links(j, pick, (covariances.transpose(0, 2, 1),))  # a view: its columns
        factor[:, j, j] = deviation[np.arange(n_boxes), pick - j]
        below = covariances[:, j + 1 :, j] - np.einsum(
            "bij,bj->bi", factor[:, j + 1 :, :j], factor[:, j, :j]
        )
        factor[:, j + 1 :, j] = below / factor[:, j, j, None]
        shift_j = np.einsum("bj,bj->b", factor[:, j, :j], expected[:, :j])
        ends = (end[:, j] - shift_j for end in (low, high))
        expected[:, j] = interval_moments(*(end / factor[:, j, j] for end in ends)).mean
    diagonal = np.diagonal(factor, axis1=1, axis2=2)
    coupling = factor / diagonal[:, :, None] - np.eye(d)
    return Chain(order, factor, coupling, low / diagonal, high / diagonal)


def _least_likely(lower: FloatArray, upper: FloatArray) -> IntArray:
    """Index of the least likely interval in each row; free variables last."""
    log_p = log_interval_probability(lower, upper)
    free = np.isinf(lower) & np.isinf(upper)
    return np.asarray(np.argmin(np.where(free, 1.0, log_p), axis=1))


def _swap_links(j: int, pick: IntArray, arrays: Sequence[npt.NDArray[Any]]) -> None:
    """Exchange rows `pick` (B,) and j of arrays (B, d, ...), in place."""
    boxes = np.arange(len(pick))
    for rows in arrays:
        rows[boxes, j], rows[boxes, pick] = rows[boxes, pick], rows[boxes, j].copy()


def saddle_points(chain: Chain, max_steps: int = _MAX_NEWTON) -> Tilting:
    """The saddle point of psi for every chain, by Newton's method with step halving.

    A step is good when the next one, foreseen with the same Hessian, is shorter: unlike the norm
    of the gradient this does not depend on the scales of z and tilt, which strong correlation
    drives far apart (Deuflhard 2011, "Newton Methods for Nonlinear Problems", section 3.3). A
    chain whose search stalls keeps its best point and shows it in `residual`.
    """
    n_boxes, d = chain.shape
    # Inside the box, where the first Newton steps already see its sides.
    state = np.hstack([_expected(chain)[:, : d - 1], np.zeros((n_boxes, d - 1))])
    gradient, hessian, psi = _psi(chain, state)
    active = np.flatnonzero(np.abs(gradient).max(axis=1, initial=0.0) > _TOLERANCE)
    for _ in range(max_steps):
        if not len(active):
            break
        step = np.asarray(
            np.linalg.solve(hessian[active], gradient[active, :, None])[..., 0], float
        )
        moved = _line_search(chain.take(active), active, step, (state, gradient, hessian, psi))
        active = active[moved]
        active = active[np.abs(gradient[active]).max(axis=1, initial=0.0) > _TOLERANCE]
    point, tilt = _split(state, d)
    return Tilting(tilt, point, psi, np.abs(gradient).max(axis=1, initial=0.0))


def _expected(chain: Chain) -> FloatArray:
    """Each link (B, d) at its expected value given the links before it."""
    z = np.zeros(chain.shape)
    for i in range(chain.shape[1]):
        shift = np.einsum("bj,bj->b", chain.coupling[:, i, :i], z[:, :i])
        z[:, i] = interval_moments(chain.lower[:, i] - shift, chain.upper[:, i] - shift).mean
    return z


def _line_search(
    chain: Chain, boxes: IntArray, step: FloatArray, at: tuple[FloatArray, ...]
) -> BoolArray:
    """Move each of `boxes` by its step, shortened until the next one shrinks; which moved.

    `at` holds state, gradient, Hessian and value of all boxes; those that move are updated.
    """
    state, _, hessian, _ = at
    jacobian = hessian[boxes]
    norm = (step**2).sum(axis=1)
    start = state[boxes]
    scale = np.ones(len(boxes))
    left = np.arange(len(boxes))
    for _ in range(_MAX_HALVINGS):
        trial = start[left] - scale[left, None] * step[left]
        found = (trial, *_psi(chain.take(left), trial))
        correction = np.linalg.solve(jacobian[left], found[1][..., None])[..., 0]
        better = (correction**2).sum(axis=1) < norm[left]
        for array, new in zip(at, found, strict=True):
            array[boxes[left[better]]] = new[better]
        left = left[~better]
        if not len(left):
            break
        scale[left] *= 0.4
    moved = np.ones(len(boxes), bool)
    moved[left] = False
    return moved


def _split(state: FloatArray, d: int) -> tuple[FloatArray, FloatArray]:
    """(B, 2(d-1)) -> z (B, d) and tilt (B, d); the last link of each is 0."""
    zero = np.zeros((len(state), 1))
    return np.hstack([state[:, : d - 1], zero]), np.hstack([state[:, d - 1 :], zero])


def _psi(chain: Chain, state: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Gradient (B, 2(d-1)), Hessian and value (B,) of psi (Botev 2017, eq. 11)."""
    n_boxes, d = chain.shape
    n = d - 1
    z, tilt = _split(state, d)
    shift = tilt + np.einsum("bij,bj->bi", chain.coupling, z)
    low, high = chain.lower - shift, chain.upper - shift
    log_p, moments = log_interval_probability(low, high), interval_moments(low, high)
    slope, curvature = moments.mean, moments.second - 1.0  # of log_p in the shift
    psi = (log_p + 0.5 * tilt * tilt - z * tilt).sum(axis=1)
    by_z = np.einsum("bi,bij->bj", slope, chain.coupling) - tilt
    gradient = np.hstack([by_z[:, :n], (tilt - z + slope)[:, :n]])
    weighted = curvature[:, :, None] * chain.coupling
    hessian = np.empty((n_boxes, 2 * n, 2 * n))
    hessian[:, :n, :n] = np.einsum("bki,bkj->bij", chain.coupling, weighted)[:, :n, :n]
    mixed = (weighted - np.eye(d))[:, :n, :n]
    hessian[:, n:, :n] = mixed
    hessian[:, :n, n:] = mixed.transpose(0, 2, 1)
    hessian[:, n:, n:] = np.eye(n) * moments.second[:, :n, None]
    return gradient, hessian, psi
