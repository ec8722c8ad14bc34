"""Orders that do not see all that matters: crash sets of standard normals, half of them hidden.

``left out, alone``: the order knows one of two variables; ``left out, together``: two that it does
not know matter only together; ``hidden direction``: it knows the sum of two, and their difference
matters; ``hidden direction, d = 4``: likewise, of two sums; ``left out, nothing``: what it leaves
out does not matter, so that the looks are all that it costs.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from scipy.special import ndtr

from benchmark import Benchmark, Outcomes, Rows, standard_normal
from crashrate.expressions import Expression

LEVEL = 4.2
FIRST = {"x1": "increasing"}


def _sum(i: int, j: int, names: tuple[str, ...]) -> tuple[Expression, str]:
    return Expression(f"x{i} + x{j}", names), "increasing"


def _any(*probabilities: float) -> float:
    """Of independent events."""
    return -math.expm1(sum(math.log1p(-p) for p in probabilities))


def left_out_alone() -> Benchmark:
    """Two variables beyond one level each, an order on the first."""

    def crash(x: Rows) -> Outcomes:
        return np.asarray(x.max(axis=1) >= LEVEL)

    tail = float(ndtr(-LEVEL))
    return Benchmark(standard_normal(2), FIRST, crash, _any(tail, tail))


def left_out_together(level: float = 2.7) -> Benchmark:
    """The first variable, or both of two others, which the order does not know."""

    def crash(x: Rows) -> Outcomes:
        return (x[:, 0] >= LEVEL) | (x[:, 1:].min(axis=1) >= level)

    p = _any(float(ndtr(-LEVEL)), float(ndtr(-level)) ** 2)
    return Benchmark(standard_normal(3), FIRST, crash, p)


def hidden_direction() -> Benchmark:
    """The sum of two variables, known to the order, or their difference."""
    traffic, level = standard_normal(2), LEVEL * math.sqrt(2)

    def crash(x: Rows) -> Outcomes:
        return np.asarray(x[:, 0] + np.abs(x[:, 1]) >= level)

    tail = float(ndtr(-LEVEL))
    return Benchmark(traffic, {"sum": _sum(1, 2, traffic.names)}, crash, _any(tail, tail))


def hidden_direction_in_four(level: float = 4.0) -> Benchmark:
    """Either of two sums, known to the order, or the difference of one."""
    traffic = standard_normal(4)
    risk: dict[str, Any] = {"s": _sum(1, 2, traffic.names), "t": _sum(3, 4, traffic.names)}
    ways = np.array([[1, 1, 0, 0], [1, -1, 0, 0], [0, 0, 1, 1]]) / math.sqrt(2)

    def crash(x: Rows) -> Outcomes:
        return np.asarray((x @ ways.T).max(axis=1) >= level)

    return Benchmark(traffic, risk, crash, _any(*[float(ndtr(-level))] * 3))


def left_out_nothing() -> Benchmark:
    """The first of three variables, and an order on it."""

    def crash(x: Rows) -> Outcomes:
        return np.asarray(x[:, 0] >= LEVEL)

    return Benchmark(standard_normal(3), FIRST, crash, float(ndtr(-LEVEL)))


UNSEEN: Mapping[str, Callable[[], Benchmark]] = {
    "left out, alone": left_out_alone,
    "left out, together": left_out_together,
    "hidden direction": hidden_direction,
    "hidden direction, d = 4": hidden_direction_in_four,
    "left out, nothing": left_out_nothing,
}
