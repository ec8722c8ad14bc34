"""The coordinates of a fit: events less their mean, over their standard deviation."""

from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from crashrate.errors import InvalidInputError
from crashrate.traffic.truncated_components import Box
from crashrate.variables import FloatArray


@dataclass(frozen=True, slots=True)
class Standard:
    """Centre and scale (d,) of the events, the box in their units, and their correlation."""

    centre: FloatArray
    scale: FloatArray
    lower: FloatArray
    upper: FloatArray
    correlation: FloatArray

    @classmethod
    def of(cls, rows: FloatArray, lower: FloatArray, upper: FloatArray) -> Self:
        """The standard coordinates of events (n, d)."""
        centre = rows.mean(axis=0)
        deviation = rows.std(axis=0)
        # A constant column has rounding for a deviation: leave it in its own units.
        constant = deviation <= 1e-12 * np.maximum(np.abs(centre), np.finfo(float).tiny)
        scale = np.where(constant, 1.0, deviation)
        away = (rows - centre) / scale
        return cls(centre, scale, lower, upper, away.T @ away / len(rows))

    @property
    def box(self) -> Box:
        """The box in standard coordinates."""
        return Box(self.forward(self.lower), self.forward(self.upper))

    def forward(self, rows: FloatArray) -> FloatArray:
        """Units of the data -> standard."""
        return (rows - self.centre) / self.scale

    def back(self, rows: FloatArray) -> FloatArray:
        """Standard -> units of the data."""
        return self.centre + self.scale * rows

    def forward_covariances(self, covariances: FloatArray) -> FloatArray:
        """Covariances (K, d, d): units of the data -> standard."""
        return covariances / (self.scale[:, None] * self.scale)

    def back_covariances(self, covariances: FloatArray) -> FloatArray:
        """Covariances (K, d, d): standard -> units of the data."""
        return covariances * (self.scale[:, None] * self.scale)

    def drift(self, means: FloatArray) -> float:
        """How far the farthest of standard means (K, d) lies outside the box."""
        box = self.box
        outside = np.maximum(box.lower - means, means - box.upper)
        return float(np.maximum(outside, 0.0).max())


def checked_sides(
    lower: npt.ArrayLike | None, upper: npt.ArrayLike | None, rows: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Sides (d,) of the box that holds events (n, d).

    Raises
    ------
    InvalidInputError
        If shapes do not fit, lower >= upper, or an event lies outside.
    """
    low = _side("lower", lower, -np.inf, rows.shape[1])
    high = _side("upper", upper, np.inf, rows.shape[1])
    if not (low < high).all():
        raise InvalidInputError(f"box: expected lower < upper, got {low} and {high}.")
    outside = np.argwhere((rows < low) | (rows > high))
    if len(outside):
        i, j = (int(v) for v in outside[0])
        n_rows = len(np.unique(outside[:, 0]))
        raise InvalidInputError(
            f"X: expected events inside the box, got {rows[i, j]} at row {i}, column {j}, where "
            f"[{low[j]}, {high[j]}] is allowed ({n_rows} such rows); widen the box or drop them."
        )
    return low, high


def _side(name: str, value: npt.ArrayLike | None, default: float, d: int) -> FloatArray:
    """One side as (d,); None, or a None in it, stands for no limit."""
    given = np.asarray(default if value is None else value, dtype=np.float64)
    if given.ndim > 1 or (given.ndim == 1 and given.shape != (d,)):
        raise InvalidInputError(
            f"{name}: expected a number or one for each of {d} columns, got shape {given.shape}."
        )
    sides = np.broadcast_to(given, (d,)).copy()
    sides[np.isnan(sides)] = default  # numpy makes a None a nan
    return sides
