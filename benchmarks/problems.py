"""Rare-event problems whose probability is known: exactly, or better than any campaign knows it.

A, B, C, D and ``corner`` are monotone (Gaussian mixtures, two to six variables), so are ``linear``
and ``random walk`` in ten; ``disc`` is not; ``cut-in`` is the published traffic model with the
ACC + AEB vehicle under test. ``linear, d = 4, 1e-3`` and its kin are half-spaces at every power of
ten from 1e-2 to 1e-9. What else there is, and why, say `wider.py`
and `unseen.py`.
"""

import math
from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from benchmark import Benchmark, Outcomes, Rows, mixture, order_of, standard_normal
from braking_follower import margin_left
from crashrate.expressions import Expression
from random_walk import crossing_probability
from unseen import UNSEEN
from wider import WIDER


def linear(d: int, probability: float = 1e-6, *, ordered: bool = True) -> Benchmark:
    """A: a half-space of d standard normals, of an exact probability."""
    from scipy.special import ndtri

    traffic, level = standard_normal(d), -math.sqrt(d) * ndtri(probability)

    def crash(x: Rows) -> Outcomes:
        return np.asarray(x.sum(axis=1) >= level)

    def margin(x: Rows) -> Rows:
        return np.asarray(level - x.sum(axis=1))

    order = order_of(traffic, *["increasing"] * d) if ordered else None
    return Benchmark(traffic, order, crash, probability, margin)


def half_spaces() -> dict[str, Callable[[], Benchmark]]:
    """`linear` at every power of ten from 1e-2 to 1e-9, in 1 to 10 variables, both ways."""
    return {
        f"linear, d = {d}, {p}{', no order' * (not ordered)}": partial(
            linear, d, float(p), ordered=ordered
        )
        for d in (1, 2, 4, 10)
        for p in (f"1e-{k}" for k in range(2, 10))
        for ordered in (True, False)
    }


def random_walk(d: int = 10, level: float = 15.0) -> Benchmark:
    """A walk of d standard normal steps that rises to `level` at any of them.

    Reference: the walk's law, step by step, by quadrature; relative error below 1e-10.
    """
    traffic = standard_normal(d)

    def crash(x: Rows) -> Outcomes:
        return np.asarray(x.cumsum(axis=1).max(axis=1) >= level)

    def margin(x: Rows) -> Rows:
        return np.asarray(level - x.cumsum(axis=1).max(axis=1))

    order = order_of(traffic, *["increasing"] * d)
    return Benchmark(traffic, order, crash, crossing_probability(level, d), margin)


def three_corners() -> Benchmark:
    """B: three correlated components; the union of three rounded corners ∏ (x - c) ≥ t, x > c.

    Reference: relative standard error 4e-7; importance sampling agrees to its 0.25 %.
    """
    corners = np.array([[3.88, 0.89, 0.29], [0.59, 3.93, 0.79], [1.495, 1.36, 3.195]])
    levels = np.array([0.9, 0.6, 0.8])
    traffic = mixture(
        [0.5, 0.3, 0.2],
        [[0.0, 0.0, 0.0], [1.0, -0.5, 0.3], [-0.6, 0.9, -0.4]],
        [
            [[1.0, 0.3, 0.1], [0.3, 1.0, -0.2], [0.1, -0.2, 1.0]],
            [[0.8, -0.25, 0.1], [-0.25, 1.1, 0.35], [0.1, 0.35, 0.9]],
            [[1.2, 0.2, 0.4], [0.2, 0.7, 0.05], [0.4, 0.05, 1.0]],
        ],
    )

    def crash(x: Rows) -> Outcomes:
        # a factor below zero is set to zero: outside x > c no product reaches its level
        beyond = np.maximum(x[:, None, :] - corners, 0.0)
        return np.any(beyond.prod(axis=2) >= levels, axis=1)

    def margin(x: Rows) -> Rows:
        shifts = [_shift(x - c, t) for c, t in zip(corners, levels, strict=True)]
        return np.asarray(np.min(shifts, axis=0))

    order = order_of(traffic, *["increasing"] * 3)
    return Benchmark(traffic, order, crash, 1.1568563060894011e-06, margin)


def _shift(x: Rows, level: float) -> Rows:
    """How far (1, …, 1) must carry `x` until all coordinates are positive with product `level`.

    The product is convex and increasing there, so Newton's method comes down from above.
    """
    shift = level ** (1 / x.shape[1]) - x.min(axis=1)
    for _ in range(60):
        there = x + shift[:, None]
        product = there.prod(axis=1)
        step = (product - level) / (product * (1 / there).sum(axis=1))
        shift = shift - step
        if np.all(np.abs(step) <= 1e-14 * (1 + np.abs(shift))):
            return shift
    raise ArithmeticError(f"margin of problem B: Newton's step is still {np.abs(step).max():.2g}.")


def follower() -> Benchmark:
    """C: speed, 1/TTC and 1/range, three components truncated at zero, a closed-form follower.

    Reference: relative standard error 6e-5; importance sampling agrees to its 0.17 %.
    """

    def covariance(deviations: list[float], r12: float, r13: float, r23: float) -> Rows:
        correlation = np.array([[1, r12, r13], [r12, 1, r23], [r13, r23, 1]])
        return np.asarray(correlation * np.outer(deviations, deviations))

    means = np.array([[24.0, 0.09, 0.034], [14.0, 0.14, 0.048], [8.0, 0.22, 0.070]])
    covariances = np.stack(
        [
            covariance([5.0, 0.060, 0.0060], -0.10, -0.20, 0.30),
            covariance([5.0, 0.095, 0.0092], -0.10, -0.15, 0.35),
            covariance([4.0, 0.118, 0.0150], -0.05, -0.10, 0.35),
        ]
    )
    # the weights are of the untruncated components; a traffic model's are of the truncated ones
    masses = mixture([1 / 3] * 3, means, covariances, lower=0.0).component_masses
    weights = np.array([0.6, 0.3, 0.1]) * masses
    traffic = mixture(weights / weights.sum(), means, covariances, lower=0.0)
    order = order_of(traffic, "decreasing", "increasing", "decreasing")

    def margin(x: Rows) -> Rows:
        return margin_left(*x.T)

    return Benchmark(traffic, order, lambda x: margin(x) <= 0, 1.2578611713711024e-06, margin)


def lognormal_sum() -> Benchmark:
    """D: Σ exp(a x) ≥ 17.25 of six standard normals.

    Reference: relative standard error 1e-7; importance sampling agrees to its 0.8 %.
    """
    exponents = np.array([0.50, 0.45, 0.45, 0.40, 0.40, 0.35])
    traffic = standard_normal(6)

    def crash(x: Rows) -> Outcomes:
        return np.asarray(np.exp(x * exponents).sum(axis=1) >= 17.25)

    def margin(x: Rows) -> Rows:
        # logarithms: nearly linear in x, kinder to a gradient than the sum
        return np.asarray(math.log(17.25) - np.log(np.exp(x * exponents).sum(axis=1)))

    order = order_of(traffic, *["increasing"] * 6)
    return Benchmark(traffic, order, crash, 9.432762980128471e-07, margin)


def corner() -> Benchmark:
    """Both of two standard normals above 3.09: monotone, with an edge no plane comes near; 1e-6."""
    traffic = standard_normal(2)

    def crash(x: Rows) -> Outcomes:
        return np.all(x >= 3.090232306167813, axis=1)  # Φ(-3.09…) = 1e-3

    return Benchmark(traffic, order_of(traffic, *["increasing"] * 2), crash, 1e-6)


def disc(*, ordered: bool = False) -> Benchmark:
    """Inside a circle around (4.6, 1.5) whose probability under two standard normals is 1e-6.

    Monotone in nothing. `ordered` declares, wrongly, that both coordinates are increasing.
    """
    from scipy.optimize import brentq
    from scipy.stats import ncx2

    center, traffic = np.array([4.6, 1.5]), standard_normal(2)
    radius = brentq(lambda r: ncx2.cdf(r * r, 2, center @ center) - 1e-6, 0.1, 2.0, xtol=1e-14)

    def crash(x: Rows) -> Outcomes:
        return ((x - center) ** 2).sum(axis=1) <= radius**2

    def margin(x: Rows) -> Rows:
        return np.asarray(((x - center) ** 2).sum(axis=1) - radius**2)

    order = order_of(traffic, *["increasing"] * 2) if ordered else None
    return Benchmark(traffic, order, crash, 1e-6, margin)


def two_sides(upper: float, lower: float) -> Benchmark:
    """The first of two standard normals beyond either of two quantiles: two regions, no order."""
    from scipy.special import ndtri

    top, bottom = -ndtri(upper), ndtri(lower)

    def crash(x: Rows) -> Outcomes:
        return (x[:, 0] > top) | (x[:, 0] < bottom)

    return Benchmark(standard_normal(2), None, crash, upper + lower)


def elbow(d: int, *, share: float = 1e-4) -> Benchmark:
    """One of the first two of d standard normals above a quantile, no order declared: an L."""
    from scipy.special import ndtri

    level = -ndtri(share)

    def crash(x: Rows) -> Outcomes:
        return np.any(x[:, :2] > level, axis=1)

    return Benchmark(standard_normal(d), None, crash, 1 - (1 - share) ** 2)


def cut_in() -> Benchmark:
    """The published traffic model of cut-ins, and the published ACC + AEB vehicle.

    Reference: importance sampling of this vehicle and model.
    """
    from crashrate.datasets import spmd_mixture
    from crashrate.simulators.acc_aeb import AccAeb

    traffic, vehicle = spmd_mixture(), AccAeb.published()

    def derived(text: str, direction: str) -> tuple[Expression, str]:
        return Expression(text, traffic.names), direction

    def crash(x: Rows) -> Outcomes:
        v, inverse_range, inverse_ttc = x.T
        gap = 1 / inverse_range
        return vehicle.run(v_lead=v, range=gap, closing_speed=gap * inverse_ttc).crash

    risk = {
        "v_lead": "decreasing",
        "closing_speed": derived("inv_ttc / inv_range", "increasing"),
        "range": derived("1 / inv_range", "decreasing"),
    }
    return Benchmark(traffic, risk, crash, 1.976e-6)


PROBLEMS: Mapping[str, Callable[[], Benchmark]] = {
    "A": lambda: linear(2),
    "A at 1e-4": lambda: linear(2, 1e-4),
    "A at 0.01": lambda: linear(2, 1e-2),
    "A at 0.3": lambda: linear(2, 0.3),
    "B": three_corners,
    "C": follower,
    "D": lognormal_sum,
    "corner": corner,
    "disc": disc,
    "disc, wrong order": lambda: disc(ordered=True),
    "two sides": lambda: two_sides(5e-5, 5e-5),
    "uneven sides": lambda: two_sides(8e-6, 2e-6),
    "elbow": lambda: elbow(2),
    "elbow, d = 3": lambda: elbow(3),
    "linear, d = 10": lambda: linear(10),
    "random walk, d = 10": random_walk,
    "cut-in": cut_in,
    "half of the time, d = 2": lambda: linear(2, 0.5),
    "half of the time, d = 4": lambda: linear(4, 0.5),
    **half_spaces(),
    **WIDER,
    **UNSEEN,
}
