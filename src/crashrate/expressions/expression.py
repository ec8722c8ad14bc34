"""The expression: a formula in named columns."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from crashrate.errors import ExpressionError, InvalidInputError
from crashrate.expressions.compiler import compile_text
from crashrate.expressions.half_space import HalfSpace, half_space_of
from crashrate.expressions.program import Program, evaluate
from crashrate.variables import FloatArray


@dataclass(frozen=True)
class Expression:
    """A formula in the columns `names`, such as ``"inv_ttc / inv_range"``.

    Allowed are ``+ - * / **``, parentheses, numbers, names, and the functions exp, log, sqrt, abs,
    min and max; an exponent is a constant of at most 100 in size.

    Parameters
    ----------
    text : str
    names : sequence of str
        The columns of the rows that the expression is called on, in their order.
    definitions : sequence of (name, Expression)
        Derived quantities that the text may use, over the same `names`; see `parse`.

    Raises
    ------
    ExpressionError
        If the text is anything else; the message quotes it and the part that is refused.
    """

    text: str
    names: tuple[str, ...]
    definitions: tuple[tuple[str, "Expression"], ...] = field(default=(), repr=False)
    program: Program = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))
        object.__setattr__(self, "definitions", tuple(self.definitions))
        self._check_definitions()
        definitions = {name: expression.program for name, expression in self.definitions}
        program = compile_text(self.text, self.names, definitions)
        object.__setattr__(self, "program", program)

    @classmethod
    def parse(
        cls,
        text: str,
        names: Sequence[str],
        derived: Mapping[str, "Expression"] | None = None,
    ) -> "Expression":
        """The expression `text` on `names`, which may use the quantities in `derived` by name."""
        return cls(text, tuple(names), tuple((derived or {}).items()))

    @property
    def used(self) -> tuple[str, ...]:
        """The columns that the value depends on, in the order of `names`."""
        indices = {int(index) for operation, index in self.program if operation == "column"}
        return tuple(self.names[index] for index in sorted(indices))

    def __call__(self, x: npt.ArrayLike) -> FloatArray:
        """The values at rows `x`.

        Division by zero gives an infinite value and an undefined operation (``0/0``, the logarithm
        or root of a negative number) gives NaN, without a warning: what either means is for the
        caller to say.

        Parameters
        ----------
        x : array (n, d)
            Columns in the order of `names`.

        Returns
        -------
        array (n,), float64

        Raises
        ------
        InvalidInputError
            If `x` has another shape.
        """
        rows = np.asarray(x, dtype=np.float64)
        if rows.ndim != 2 or rows.shape[1] != len(self.names):
            raise InvalidInputError(
                f"expression {self.text!r}: expected rows of shape (n, {len(self.names)}) with the "
                f"columns {', '.join(self.names)}, got shape {rows.shape}."
            )
        return evaluate(self.program, rows)

    def half_space(
        self,
        level: float,
        sign: float = 1.0,
        lower: npt.ArrayLike | None = None,
        upper: npt.ArrayLike | None = None,
    ) -> HalfSpace | None:
        """The half-space ``{x in the box: sign * e(x) >= level}``, or None where it is not one.

        It is one where e is linear-fractional, ``(p @ x + p0) / (q @ x + q0)``, with a denominator
        of one sign inside the box: then the inequality is multiplied by the denominator. (On a face
        of the box where the denominator is zero the set is the limit from inside.) Rows with
        ``sign * e(x)`` equal to `level` up to rounding may fall on either side.

        Parameters
        ----------
        level : float
            Finite.
        sign : float
            +1 for ``e(x) >= level``, -1 for ``e(x) <= -level``.
        lower, upper : array (d,), optional
            The box; infinite where not given.

        Raises
        ------
        InvalidInputError
            If `level` is not finite, `sign` is not ±1 or the box has another shape.
        """
        if not np.isfinite(level) or sign not in {1.0, -1.0}:
            raise InvalidInputError(
                f"expression {self.text!r}: expected a finite level and a sign of 1 or -1, "
                f"got level = {level} and sign = {sign}."
            )
        return half_space_of(self.program, level, sign, *self._box(lower, upper))

    def _box(
        self, lower: npt.ArrayLike | None, upper: npt.ArrayLike | None
    ) -> tuple[FloatArray, FloatArray]:
        d = len(self.names)
        lo = np.asarray(-np.inf if lower is None else lower, dtype=np.float64)
        hi = np.asarray(np.inf if upper is None else upper, dtype=np.float64)
        for side in (lo, hi):
            if side.shape not in {(), (d,)}:
                raise InvalidInputError(
                    f"expression {self.text!r}: expected bounds of shape ({d},) for the columns "
                    f"{', '.join(self.names)}, got {side.shape}."
                )
        return np.broadcast_to(lo, d), np.broadcast_to(hi, d)

    def _check_definitions(self) -> None:
        for name, expression in self.definitions:
            if name in self.names:
                raise ExpressionError(
                    f"derived quantity {name!r}: the name is taken by a variable "
                    f"({', '.join(self.names)}); choose another one."
                )
            if expression.names != self.names:
                raise ExpressionError(
                    f"derived quantity {name!r}: expected an expression on the columns "
                    f"({', '.join(self.names)}), got one on ({', '.join(expression.names)})."
                )
