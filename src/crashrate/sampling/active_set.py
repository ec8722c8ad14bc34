"""The point of a polyhedron that is nearest to the origin, by a dual active-set method.

Reference: D. Goldfarb, A. Idnani, "A numerically stable dual method for solving strictly convex
quadratic programs", Mathematical Programming 27 (1983), for a Hessian equal to the identity.
"""

from typing import NamedTuple

import numpy as np

from crashrate.errors import NumericalError
from crashrate.variables import FloatArray

# Normals have unit length: what is left of one outside the span of others, and by how much a
# constraint may be missed relative to 1 + |offset|.
_DEPENDENT = 1e-10
_MISSED = 1e-10


class LeastNorm(NamedTuple):
    """The nearest point z (d,) and the multipliers (c,), with z = normals.T @ multipliers."""

    z: FloatArray
    multipliers: FloatArray


class _Active(NamedTuple):
    """Constraints that hold with equality, and their multipliers."""

    rows: list[int]
    multipliers: FloatArray


def least_norm(normals: FloatArray, offsets: FloatArray) -> LeastNorm | None:
    """argmin |z| subject to normals @ z >= offsets.

    Constraints enter one by one, the most missed first; a constraint leaves when its multiplier
    would fall below zero. |z| grows with every entry, so that no active set comes back: the method
    ends with the solution, or with a proof that there is none.

    Parameters
    ----------
    normals : (c, d) array
        Rows of unit length.
    offsets : (c,) array
        Finite.

    Returns
    -------
    LeastNorm or None
        None where no point satisfies the constraints.

    Raises
    ------
    NumericalError
        If rounding makes the active sets cycle.
    """
    c, d = normals.shape
    scale = 1.0 + np.abs(offsets)
    z: FloatArray = np.zeros(d)
    rows: list[int] = []
    multipliers: FloatArray = np.empty(0)
    for _ in range(10 * (c + d) + 10):
        missed = (offsets - normals @ z) / scale
        missed[rows] = 0.0  # these hold, up to rounding
        if not c or missed.max() <= _MISSED:
            spread = np.zeros(c)
            spread[rows] = multipliers
            return LeastNorm(z, spread)
        entered = _enter(normals, offsets, _Active(rows, multipliers), int(missed.argmax()))
        if entered is None:
            return None
        rows = entered.rows
        # solved anew from the active equations: no rounding accumulates over the entries
        z = _least_squares(normals[rows], offsets[rows])
        multipliers = _least_squares(normals[rows].T, z)
    raise NumericalError(
        f"nearest point of {c} half-spaces in {d} dimensions: the active set did not settle; "
        "the constraints are nearly dependent."
    )


def _enter(
    normals: FloatArray, offsets: FloatArray, active: _Active, entering: int
) -> _Active | None:
    """The active set with one more constraint, perhaps instead of others; None if impossible."""
    rows, multipliers = active
    normal, price = normals[entering], 0.0
    while True:
        basis = normals[rows].T
        share = _least_squares(basis, normal) if rows else multipliers
        outside = normal - basis @ share
        room = float(outside @ outside)
        missed = float(offsets[entering] - normal @ (basis @ multipliers + price * normal))
        full = missed / room if room > _DEPENDENT**2 else np.inf
        # how far the multipliers can go before one of them vanishes
        falling = np.flatnonzero(share > _DEPENDENT)
        ratios = multipliers[falling] / share[falling]
        if not len(falling) or full <= ratios.min():
            if not np.isfinite(full):
                return None
            multipliers = np.append(multipliers - full * share, price + full)
            return _Active([*rows, entering], multipliers)
        length, leaving = ratios.min(), int(falling[ratios.argmin()])
        multipliers = np.delete(multipliers - length * share, leaving)
        price += length
        rows = [*rows[:leaving], *rows[leaving + 1 :]]


def _least_squares(a: FloatArray, b: FloatArray) -> FloatArray:
    """The shortest of the solutions of a @ x = b, or of the least-squares ones."""
    return np.asarray(np.linalg.lstsq(a, b, rcond=None)[0], np.float64)
