"""Half-spaces of linear-fractional expressions, by algebra on ratios of affine forms.

An affine form in d columns is its (d + 1,) coefficients, the constant last.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from crashrate.expressions.program import OPERATIONS, Program, interpret
from crashrate.variables import BoolArray, FloatArray, frozen

ROUNDING = 1e-13  # relative difference below which two affine forms are the same one


@dataclass(frozen=True, eq=False)
class HalfSpace:
    """The set ``{x: normal @ x >= offset}``; unpacks as ``normal, offset``.

    Parameters
    ----------
    normal : array (d,)
    offset : float
    """

    normal: FloatArray
    offset: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "normal", frozen(self.normal))

    def __iter__(self) -> Iterator[FloatArray | float]:
        yield self.normal
        yield self.offset

    def contains(self, x: npt.ArrayLike) -> BoolArray:
        """Which rows of `x` (n, d) lie in the half-space: (n,)."""
        inside: BoolArray = np.asarray(x, dtype=np.float64) @ self.normal >= self.offset
        return inside


def half_space_of(
    program: Program, level: float, sign: float, lower: FloatArray, upper: FloatArray
) -> HalfSpace | None:
    """The half-space {x in the box: sign * e(x) >= level}, or None; see `Expression.half_space`."""
    ratio = _ratio(program, len(lower))
    if ratio is None:
        return None
    positive = _sign_on_box(ratio.denominator, lower, upper)
    if positive == 0.0:
        return None
    # n / d >= level  <=>  ±(n - level d) >= 0, with the sign of d
    form = positive * (sign * ratio.numerator - level * ratio.denominator)
    return HalfSpace(form[:-1], 0.0 - float(form[-1]))  # never -0.0


@dataclass(frozen=True, eq=False)
class Ratio:
    """numerator(x) / denominator(x), both affine."""

    numerator: FloatArray
    denominator: FloatArray

    @classmethod
    def constant(cls, value: float, d: int) -> "Ratio":
        """The number `value`, in d columns."""
        return cls(value * _one(d), _one(d))

    @property
    def value(self) -> float | None:
        """The number that this is everywhere, or None."""
        return _multiple(self.numerator, self.denominator)

    def __neg__(self) -> "Ratio":
        return Ratio(-self.numerator, self.denominator)

    def inverse(self) -> "Ratio":
        """One over this ratio."""
        return Ratio(self.denominator, self.numerator)

    def power(self, exponent: float | None) -> "Ratio | None":
        """The power 0, 1 or -1; others are not linear-fractional."""
        if exponent == 0.0:
            return Ratio.constant(1.0, len(self.numerator) - 1)
        if exponent == 1.0:
            return self
        return self.inverse() if exponent == -1.0 else None

    def times(self, other: "Ratio") -> "Ratio | None":
        """The product, after cancelling each numerator against the other's denominator."""
        n1, d2 = _cancel(self.numerator, other.denominator)
        n2, d1 = _cancel(other.numerator, self.denominator)
        numerator, denominator = _product(n1, n2), _product(d1, d2)
        if numerator is None or denominator is None:
            return None
        return Ratio(numerator, denominator)

    def plus(self, other: "Ratio") -> "Ratio | None":
        """The sum, where the denominators agree up to a factor or one term is a constant."""
        for a, b in ((self, other), (other, self)):
            if b.value is not None:  # a + c = (n + c d) / d
                return Ratio(a.numerator + b.value * a.denominator, a.denominator)
        factor = _multiple(self.denominator, other.denominator)  # d1 = factor d2
        if factor is None:
            return None
        return Ratio(self.numerator + factor * other.numerator, self.denominator)


def _one(d: int) -> FloatArray:
    """The affine form that is 1 everywhere."""
    one: FloatArray = np.eye(d + 1)[d]
    return one


def _multiple(a: FloatArray, b: FloatArray) -> float | None:
    """The number s with ``a = s b``, or None."""
    pivot = int(np.argmax(np.abs(b)))
    factor = float(a[pivot] / b[pivot])
    same = np.abs(a - factor * b).max() <= ROUNDING * np.abs(a).max()
    return factor if same else None


def _cancel(numerator: FloatArray, denominator: FloatArray) -> tuple[FloatArray, FloatArray]:
    factor = _multiple(numerator, denominator)
    one = _one(len(numerator) - 1)
    return (numerator, denominator) if factor is None else (factor * one, one)


def _product(a: FloatArray, b: FloatArray) -> FloatArray | None:
    """The product of two affine forms where one of them is a constant, or None."""
    if not a[:-1].any():
        a, b = b, a
    if b[:-1].any():
        return None
    product: FloatArray = b[-1] * a
    return product


@lru_cache(maxsize=256)  # asked again at every corner of the crash set
def _ratio(program: Program, d: int) -> Ratio | None:
    """The expression as a ratio of affine forms, or None."""

    def column(index: int) -> Ratio | None:
        return Ratio(np.eye(d + 1)[index], _one(d))

    with np.errstate(all="ignore"):  # a constant such as 1/0 is inf, and refused below
        ratio = interpret(program, lambda value: Ratio.constant(value, d), column, _apply)
    finite = ratio is not None and np.isfinite([ratio.numerator, ratio.denominator]).all()
    return ratio if finite else None


def _apply(operation: str, operands: list[Ratio | None]) -> Ratio | None:
    ratios = [ratio for ratio in operands if ratio is not None]
    if len(ratios) < len(operands):
        return None
    values = [ratio.value for ratio in ratios]
    if None in values:
        return _combine(operation, *ratios)
    number = OPERATIONS[operation](*np.array(values, dtype=np.float64))
    return Ratio.constant(float(number), len(ratios[0].numerator) - 1)


def _combine(operation: str, a: Ratio, *others: Ratio) -> Ratio | None:
    """One operation on ratios that are not all constant."""
    b = others[0] if others else a
    combined: dict[str, Callable[[], Ratio | None]] = {
        "negative": lambda: -a,
        "+": lambda: a.plus(b),
        "-": lambda: a.plus(-b),
        "*": lambda: a.times(b),
        "/": lambda: a.times(b.inverse()),
        "**": lambda: a.power(b.value),
    }
    return combined.get(operation, lambda: None)()


def _sign_on_box(form: FloatArray, lower: FloatArray, upper: FloatArray) -> float:
    """+1 or -1 where the affine `form` has that sign inside the box, 0 where it changes."""
    used = form[:-1] != 0.0  # 0 * inf is not wanted
    ends = form[:-1][used] * np.stack([lower[used], upper[used]])
    least = ends.min(axis=0).sum() + form[-1]
    most = ends.max(axis=0).sum() + form[-1]
    if least >= 0.0 and most > 0.0:
        return 1.0
    return -1.0 if most <= 0.0 and least < 0.0 else 0.0
