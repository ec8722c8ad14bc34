"""Severity: how a recorded event is made worse, by a factor that leaves it as it is at 1."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from crashrate.errors import InvalidInputError
from crashrate.expressions import Expression
from crashrate.variables import BoolArray, FloatArray, nearest

FACTOR = "severity"
LEVELS = (1.0, 1.3, 1.5, 2.0, 2.5)
Crashes = Callable[[FloatArray], BoolArray]


@dataclass(frozen=True)
class Severity:
    """Variables of an event as functions of themselves and of a factor named ``severity``.

    Parameters
    ----------
    names : tuple of str, length d
        The traffic model's variables.
    changed : mapping
        Variable's name to an `Expression` on ``(*names, "severity")``; the others stay.
    levels : tuple of float
        Factors of the ladder, growing from 1 (the event as recorded).

    Raises
    ------
    InvalidInputError
        If nothing is changed, a name is unknown, or the levels do not grow from 1.
    """

    names: tuple[str, ...]
    changed: Mapping[str, Expression]
    levels: tuple[float, ...] = LEVELS

    def __post_init__(self) -> None:
        if not self.changed:
            raise InvalidInputError(
                "severity: expected at least one variable, such as closing_speed = "
                f"'closing_speed * {FACTOR}'."
            )
        for name in self.changed:
            if name not in self.names:
                raise InvalidInputError(
                    f"severity: unknown variable {name!r}{nearest(name, self.names)}."
                )
        if not (len(self.levels) > 1 and self.levels[0] == 1 and _grow(self.levels)):
            raise InvalidInputError(
                f"severity levels: expected numbers that grow from 1, such as {list(LEVELS)}, "
                f"got {list(self.levels)}."
            )

    @classmethod
    def multiplying(cls, name: str, names: Sequence[str]) -> "Severity":
        """The severity that multiplies one variable, such as the closing speed."""
        known = (*names, FACTOR)
        return cls(tuple(names), {name: Expression(f"{name} * {FACTOR}", known)})

    def __call__(self, x: FloatArray, factor: float | FloatArray) -> FloatArray:
        """Situations x (n, d) made worse by `factor`, one for all or one a row: (n, d)."""
        column = np.broadcast_to(np.asarray(factor, float), (len(x),))
        given = np.column_stack([x, column])
        worse = np.array(x, dtype=np.float64)
        for name, expression in self.changed.items():
            worse[:, self.names.index(name)] = expression(given)
        return worse

    def first_levels(self, x: FloatArray, crashes: Crashes) -> np.ndarray:
        """Index (n,) of the least level from which on each situation crashes at all levels.

        The number of levels where it is safe at the worst. A fixed set of situations for each
        level, nested, whether or not danger grows with the factor everywhere.
        """
        first = np.full(len(x), len(self.levels))
        left = np.arange(len(x))
        for j in range(len(self.levels) - 1, -1, -1):
            left = left[crashes(self(x[left], self.levels[j]))]
            first[left] = j
        return first

    def critical_factors(
        self, x: FloatArray, crashes: Crashes, high: float, n_halvings: int = 14
    ) -> FloatArray:
        """Factor (n,) in [1, high] at which each situation begins to crash, by bisection.

        Of situations that crash at `high`; 1 where one crashes as it is.
        """
        below, above = np.zeros(len(x)), np.full(len(x), np.log(high))
        above[crashes(self(x, 1.0))] = 0.0
        for _ in range(n_halvings):
            middle = (below + above) / 2
            there = crashes(self(x, np.exp(middle)))
            above, below = np.where(there, middle, above), np.where(there, below, middle)
        return np.asarray(np.exp((below + above) / 2))


def _grow(levels: Sequence[float]) -> bool:
    return all(a < b for a, b in pairwise(levels))
