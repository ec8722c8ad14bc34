"""Dominating points where a risk coordinate's level sets are not half-spaces.

A sequential quadratic programme (SLSQP) proposes a point; it is taken only if it satisfies the
constraints and the first-order optimality conditions. Those are necessary, not sufficient, where
the set is not convex: the point is then a local one. A proposal built on it is still a valid
density; only its efficiency depends on the point.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from crashrate.sampling.active_set import least_norm
from crashrate.sampling.dominating_points import Whitening
from crashrate.variables import FloatArray

# in standard deviations, relative to 1 + distance: what finite differences can promise
FEASIBLE = 1e-6
STATIONARY = 1e-3


class CurvedConstraint(NamedTuple):
    """values(x) >= level, for a function of rows (n, d) that has no known half-space."""

    values: Callable[[FloatArray], FloatArray]
    level: float

    def slack(self, x: FloatArray) -> float:
        """How far x (d,) is inside, relative to the level's size."""
        return float(self.values(x[None])[0] - self.level) / (1.0 + abs(self.level))


def curved_dominating_point(
    component: Whitening,
    normals: FloatArray,
    offsets: FloatArray,
    curved: tuple[CurvedConstraint, ...],
    start: FloatArray,
) -> FloatArray | None:
    """The densest point of a component under half-spaces and curved constraints.

    Parameters
    ----------
    component : Whitening
    normals, offsets : (c, d) and (c,) arrays
        normals @ x >= offsets.
    curved : tuple of CurvedConstraint
    start : (d,) array
        The dominating point without the curved constraints: the answer, where it satisfies them.

    Returns
    -------
    (d,) array or None
        None where the solver's answer does not pass the check.
    """
    if all(c.slack(start) >= 0.0 for c in curved):
        return start
    mean, factor = component
    z0 = np.asarray(np.linalg.solve(factor, start - mean), np.float64)
    slopes, levels = _unit(normals @ factor, offsets - normals @ mean)

    def slacks(z: FloatArray) -> FloatArray:
        bent = [c.slack(mean + factor @ z) for c in curved]
        return np.concatenate([slopes @ z - levels, bent])

    z = _slsqp(z0, slacks)
    jacobian = _jacobian(slacks, z)
    margin = slacks(z) / np.maximum(np.linalg.norm(jacobian, axis=1), 1e-12)
    size = 1.0 + float(np.linalg.norm(z))
    if not (np.isfinite(margin).all() and margin.min() >= -FEASIBLE * size):
        return None
    active = jacobian[margin <= STATIONARY * size]
    if not _distance_to_cone(z, active) <= STATIONARY * size:
        return None
    return mean + factor @ z


def _unit(normals: FloatArray, offsets: FloatArray) -> tuple[FloatArray, FloatArray]:
    lengths = np.linalg.norm(normals, axis=1)
    used = lengths > 0.0
    return normals[used] / lengths[used, None], offsets[used] / lengths[used]


def _slsqp(start: FloatArray, slacks: Callable[[FloatArray], FloatArray]) -> FloatArray:
    from scipy.optimize import minimize

    found = minimize(
        lambda z: 0.5 * float(z @ z),
        start,
        jac=lambda z: z,
        method="SLSQP",
        constraints={"type": "ineq", "fun": slacks},
        options={"maxiter": 200, "ftol": 1e-10},
    )
    return np.asarray(found.x, dtype=np.float64)


def _jacobian(slacks: Callable[[FloatArray], FloatArray], z: FloatArray) -> FloatArray:
    """Central differences, (c, d)."""
    step = 1e-5 * (1.0 + float(np.linalg.norm(z)))
    columns = [(slacks(z + step * e) - slacks(z - step * e)) / (2.0 * step) for e in np.eye(len(z))]
    return np.stack(columns, axis=1)


def _distance_to_cone(z: FloatArray, gradients: FloatArray) -> float:
    """Distance of z from {gradients.T @ λ: λ >= 0}: zero where z is a stationary point.

    By Moreau's decomposition it is the length of z's projection on the polar cone
    {w: gradients @ w <= 0}, a least-norm problem.
    """
    unit, _ = _unit(gradients, np.zeros(len(gradients)))
    moved = least_norm(-unit, unit @ z)
    return np.inf if moved is None else float(np.linalg.norm(z + moved.z))
