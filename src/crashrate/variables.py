"""Names, units, bounds and directions of the variables that describe an event."""

import math
import reprlib
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from enum import StrEnum
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from crashrate.errors import InvalidInputError

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]


class Word(StrEnum):
    """A choice that is given by name."""

    @classmethod
    def parse(cls, value: str, where: str) -> Self:
        """The choice named by `value`; `where` names its place in the error.

        Raises
        ------
        InvalidInputError
            If `value` is not one of the names.
        """
        try:
            return cls(value)
        except ValueError:
            words = " or ".join(repr(str(word)) for word in cls)
            raise InvalidInputError(
                f"{where}: expected {words}, got {value!r}; {cls.meaning()}."
            ) from None

    @classmethod
    def meaning(cls) -> str:
        """What one of the names stands for, as an error says it."""
        raise NotImplementedError


class Direction(Word):
    """Which way a quantity makes a situation riskier."""

    INCREASING = "increasing"
    DECREASING = "decreasing"

    @property
    def sign(self) -> float:
        """+1 where danger grows with the quantity, -1 where it falls."""
        return 1.0 if self is Direction.INCREASING else -1.0

    @classmethod
    def meaning(cls) -> str:
        """As an error says it."""
        return "'increasing' means that a larger value is riskier"


class Scale(Word):
    """On which scale a variable is modelled."""

    LINEAR = "linear"
    LOG = "log"

    @classmethod
    def meaning(cls) -> str:
        """As an error says it."""
        return "'log' models the logarithm of a positive variable"


@dataclass(frozen=True, slots=True)
class Variable:
    """One column of the traffic model.

    Parameters
    ----------
    name : str
        A Python identifier.
    unit : str
        As printed, for example ``"m/s"``.
    lower, upper : float
        Bounds of the truncation, infinite where there is none.
    scale : Scale
        On which it is modelled.
    """

    name: str
    unit: str = ""
    lower: float = -math.inf
    upper: float = math.inf
    scale: Scale = Scale.LINEAR

    def __post_init__(self) -> None:
        if not self.name.isidentifier():
            raise InvalidInputError(
                f"variable name {self.name!r}: expected a Python identifier such as 'v_lead'."
            )
        if not self.lower < self.upper:
            raise InvalidInputError(
                f"variable {self.name!r}: expected lower < upper, "
                f"got lower = {self.lower} and upper = {self.upper}."
            )
        if self.scale is Scale.LOG and not self.lower >= 0.0:
            raise InvalidInputError(
                f"variable {self.name!r}: expected lower >= 0 on a log scale, got {self.lower}; "
                "give it a lower bound, or the scale 'linear'."
            )


def nearest(word: str, known: Sequence[str]) -> str:
    """The end of an error message that names the nearest known word, and all of them."""
    match = get_close_matches(word, known, n=1, cutoff=0.5)
    guess = f"; did you mean {match[0]!r}?" if match else ""
    return f"{guess} (known: {', '.join(known)})"


def as_rows(x: npt.ArrayLike, n_columns: int, what: str = "x") -> FloatArray:
    """`x` as a finite float array of shape (n, n_columns).

    Raises
    ------
    InvalidInputError
        If the shape is another, or a value is no number or not finite: the message gives the first
        one.
    """
    rows = numbers(x, what)
    if rows.ndim != 2 or rows.shape[1] != n_columns:
        raise InvalidInputError(
            f"{what}: expected an array of shape (n, {n_columns}), got {rows.shape}."
        )
    finite = np.isfinite(rows)
    if not finite.all():
        bad = np.argwhere(~finite)
        row, column = (int(i) for i in bad[0])
        raise InvalidInputError(
            f"{what}: expected finite numbers, got {rows[row, column]} at row {row}, "
            f"column {column} ({len(bad)} such values)."
        )
    return rows


def numbers(values: npt.ArrayLike, what: str) -> FloatArray:
    """`values` as an array of floats.

    Raises
    ------
    InvalidInputError
        If they are no numbers, or nested unevenly.
    """
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidInputError(
            f"{what}: expected numbers, rows of them equally long, got {reprlib.repr(values)}."
        ) from None


def frozen(values: npt.ArrayLike, dtype: Any = np.float64) -> npt.NDArray[Any]:
    """A read-only copy: what the arrays of frozen values are made of."""
    array = np.array(values, dtype=dtype)
    array.setflags(write=False)
    return array
