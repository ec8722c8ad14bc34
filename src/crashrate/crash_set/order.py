"""Risk order: which way a situation becomes more dangerous, coordinate by coordinate."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from crashrate.errors import InvalidInputError
from crashrate.expressions import Expression, HalfSpace
from crashrate.traffic.scales import Scales
from crashrate.variables import Direction, FloatArray, as_rows, nearest

RowFunction = Callable[[FloatArray], npt.ArrayLike]
RiskMapping = Mapping[str, str | tuple[RowFunction, str]]


@dataclass(frozen=True, slots=True)
class RiskCoordinate:
    """One quantity that makes a situation riskier.

    Parameters
    ----------
    name : str
        Name of a variable, or of the derived quantity.
    direction : Direction
        Which way danger grows.
    index : int or None
        Column of the variable; None for a derived quantity.
    function : callable or None
        Rows (n, d) to values (n,), of a derived quantity; None for a variable.
    """

    name: str
    direction: Direction
    index: int | None = None
    function: RowFunction | None = None

    def values(self, x: FloatArray) -> FloatArray:
        """The quantity times the sign of its direction, (n, d) -> (n,)."""
        if self.function is None:
            return self.direction.sign * x[:, self.index]
        # what the function says of its own trouble is said better by `order(x)`: coordinate, row
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            values = np.asarray(self.function(x), dtype=np.float64)
        if values.shape != (len(x),):
            raise InvalidInputError(
                f"risk coordinate {self.name!r}: expected its function to return one number per "
                f"row, shape ({len(x)},), got shape {values.shape}."
            )
        return self.direction.sign * values


@dataclass(frozen=True, slots=True)
class RiskOrder:
    """Situations in risk coordinates: u(x), where danger grows in every column.

    A claim of the user, tested by every campaign: if u(x) <= u(y) in every coordinate and x
    crashes, then y crashes (§V.A of the 2017 paper, with coordinates flipped as it proposes).

    Parameters
    ----------
    coordinates : tuple of RiskCoordinate
        At least one.
    variables : tuple of str
        Names of the columns of x.
    scales : Scales or None
        Where given, not all linear, rows are not x but what a traffic model makes normal of it.
    """

    coordinates: tuple[RiskCoordinate, ...]
    variables: tuple[str, ...]
    scales: Scales | None = None

    @classmethod
    def from_mapping(cls, risk: RiskMapping, names: Sequence[str]) -> "RiskOrder":
        """The order declared by `risk` on the variables `names`.

        Parameters
        ----------
        risk : mapping
            A variable's name to ``"increasing"`` or ``"decreasing"`` (a larger value is riskier,
            or safer), or the name of a derived quantity to ``(function, direction)``, the
            function taking rows (n, d) of the variables: any callable, or an `Expression`, whose
            level sets the dominating points can use exactly. A variable that no coordinate depends
            on, or a direction in which none changes, is claimed not to matter.
        names : sequence of str, length d
            The traffic model's variables, in order.

        Raises
        ------
        InvalidInputError
            If `risk` is empty, names an unknown variable (the nearest is suggested), or gives
            something that is not a direction.
        """
        if not isinstance(risk, Mapping):
            raise InvalidInputError(
                "risk: expected a mapping such as {'v_lead': 'decreasing'}, got "
                f"{type(risk).__name__}."
            )
        if not risk:
            raise InvalidInputError(
                "risk: expected at least one coordinate such as {'v_lead': 'decreasing'}; "
                "pass risk=None where no monotonicity is claimed."
            )
        known = tuple(names)
        return cls(tuple(_coordinate(n, entry, known) for n, entry in risk.items()), known)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the risk coordinates, in order."""
        return tuple(c.name for c in self.coordinates)

    @property
    def n_coordinates(self) -> int:
        """Number m of risk coordinates."""
        return len(self.coordinates)

    def __call__(self, x: npt.ArrayLike) -> FloatArray:
        """Risk coordinates u (n, m) of the situations x (n, d).

        Raises
        ------
        InvalidInputError
            If x has another shape, or a coordinate is not finite: named with its row.
        """
        rows = self._situations(as_rows(x, len(self.variables)))
        u = np.empty((len(rows), self.n_coordinates))
        for k, coordinate in enumerate(self.coordinates):
            u[:, k] = coordinate.values(rows)
        self._require_finite(u, rows)
        return u

    def coordinate(self, k: int, x: FloatArray) -> FloatArray:
        """Risk coordinate k (n,) of rows (n, d), finite or not."""
        return self.coordinates[k].values(self._situations(x))

    def _situations(self, rows: FloatArray) -> FloatArray:
        return rows if self.scales is None else self.scales.back(rows)

    def _require_finite(self, u: FloatArray, x: FloatArray) -> None:
        bad = np.argwhere(~np.isfinite(u))
        if len(bad):
            row, k = (int(i) for i in bad[0])
            situation = ", ".join(
                f"{n} = {v:g}" for n, v in zip(self.variables, x[row], strict=True)
            )
            raise InvalidInputError(
                f"risk coordinate {self.names[k]!r}: expected a finite number, got {u[row, k]} at "
                f"row {row} ({situation}); bound the variables so that it stays finite."
            )

    def half_space(
        self,
        k: int,
        level: float,
        lower: npt.ArrayLike | None = None,
        upper: npt.ArrayLike | None = None,
    ) -> HalfSpace | None:
        """The set {x: u_k(x) >= level} as a half-space.

        Parameters
        ----------
        k : int
            Risk coordinate.
        level : float
            In the units of u, so with the sign of the direction.
        lower, upper : (d,) arrays, optional
            The box on which the answer must hold: a linear-fractional expression needs it, to
            know the sign of its denominator.

        Returns
        -------
        HalfSpace or None
            The set inside the box is {x: normal @ x >= offset};
            None where the set is not known to be a half-space.
        """
        if self.scales is not None:
            return self._modelled_half_space(self.scales, k, level, lower, upper)
        coordinate = self.coordinates[k]
        if coordinate.index is not None:
            normal = np.zeros(len(self.variables))
            normal[coordinate.index] = coordinate.direction.sign
            return HalfSpace(normal, float(level))
        if isinstance(coordinate.function, Expression):
            return coordinate.function.half_space(level, coordinate.direction.sign, lower, upper)
        return None

    def on(self, scales: Scales) -> "RiskOrder":
        """The same order of the rows that a traffic model with these scales makes normal."""
        return self if scales.linear else replace(self, scales=scales)

    def _modelled_half_space(
        self,
        scales: Scales,
        k: int,
        level: float,
        lower: npt.ArrayLike | None,
        upper: npt.ArrayLike | None,
    ) -> HalfSpace | None:
        """A half-space of x as one of z: where it leaves logarithms out, or asks for one alone."""
        sides = [None if side is None else scales.back(side) for side in (lower, upper)]
        found = replace(self, scales=None).half_space(k, level, *sides)
        if found is None or not (found.normal[scales.log] != 0.0).any():
            return found
        (there,) = np.nonzero(found.normal)
        if len(there) > 1:
            return None
        sign = np.sign(found.normal)
        edge = max(found.offset / float(found.normal[there[0]]), 0.0)  # no logarithm below
        with np.errstate(divide="ignore"):
            return HalfSpace(sign, float(sign[there[0]] * np.log(edge)))


def _coordinate(name: str, entry: Any, variables: tuple[str, ...]) -> RiskCoordinate:
    where = f"risk[{name!r}]"
    if isinstance(entry, str):
        if name not in variables:
            raise InvalidInputError(
                f"{where}: not a variable{nearest(name, variables)}; "
                "a derived quantity is given as (function, direction)."
            )
        return RiskCoordinate(name, Direction.parse(entry, where), index=variables.index(name))
    if entry is None:
        raise InvalidInputError(
            f"{where}: expected 'increasing', 'decreasing' or (function, direction), got None. A "
            "variable left out is claimed not to matter; risk=None as a whole claims nothing."
        )
    if not (isinstance(entry, tuple) and len(entry) == 2 and callable(entry[0])):
        raise InvalidInputError(
            f"{where}: expected 'increasing', 'decreasing' or (function, direction), got {entry!r}."
        )
    function, direction = entry
    if isinstance(function, Expression) and function.names != variables:
        raise InvalidInputError(
            f"{where}: expected an Expression of the traffic model's variables, in their order, "
            f"{variables}, got one of {function.names}."
        )
    return RiskCoordinate(name, Direction.parse(direction, where), function=function)
