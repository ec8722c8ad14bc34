"""Problems beyond the usual ones: where a campaign could fail, each with a known probability.

Curved and concave sets (``outside a ball``, ``corner``, ``union``), a rough edge (``stairs``),
a safe ``pocket``, thin sets (``strip``, ``ring``, ``stripes``, ``rare ring``), several regions
(``three half-planes``), small ones in dense traffic (``dense disc``, ``dense ball``), risk orders
that fail in places or throughout (``holes``, ``wrong sign``), outcomes that are random, traffic
that hardly reaches its box, and a vehicle that never crashes.
"""

import math
from collections.abc import Callable, Mapping

import numpy as np

from benchmark import Benchmark, Outcomes, Rows, mixture, order_of, standard_normal
from cells import in_hole, probability_with_holes, uniform
from truncated_sum import sum_probability


def outside_ball(d: int, probability: float) -> Benchmark:
    """Outside a ball around the origin of d standard normals, no order: crashes on every side."""
    from scipy.stats import chi2

    squared_radius = chi2.isf(probability, d)

    def crash(x: Rows) -> Outcomes:
        return np.asarray((x**2).sum(axis=1) >= squared_radius)

    return Benchmark(standard_normal(d), None, crash, probability)


def all_above(d: int, probability: float) -> Benchmark:
    """All of d standard normals above one level: a corner."""
    from scipy.special import ndtri

    traffic, level = standard_normal(d), -ndtri(probability ** (1 / d))

    def crash(x: Rows) -> Outcomes:
        return np.all(x >= level, axis=1)

    return Benchmark(traffic, order_of(traffic, *["increasing"] * d), crash, probability)


def any_above(d: int, probability: float) -> Benchmark:
    """Any of d standard normals above one level: a union of d half-spaces."""
    from scipy.special import ndtri

    # 1 - (1 - q)^d = p, without the cancellation
    traffic, level = standard_normal(d), -ndtri(-math.expm1(math.log1p(-probability) / d))

    def crash(x: Rows) -> Outcomes:
        return np.any(x >= level, axis=1)

    return Benchmark(traffic, order_of(traffic, *["increasing"] * d), crash, probability)


def three_half_planes(probability: float = 3e-6) -> Benchmark:
    """Two standard normals beyond any of three lines on three sides of the origin, no order.

    What lies beyond two of the lines is nearly twice as far from the origin as each of them: less
    than 1e-13 of the probability.
    """
    from scipy.special import ndtri

    angles, level = np.array([0.3, 2.4, 4.5]), -ndtri(probability / 3)
    normals = np.stack([np.cos(angles), np.sin(angles)])

    def crash(x: Rows) -> Outcomes:
        return np.any(x @ normals >= level, axis=1)

    return Benchmark(standard_normal(2), None, crash, probability)


def stairs(steps: int = 2, level: int = 8) -> Benchmark:
    """Two standard normals, each rounded down to `steps` steps a unit, whose sum is `level` steps.

    Monotone, with an edge that no smooth curve comes near.
    """
    from scipy.special import ndtr

    traffic, edges = standard_normal(2), np.arange(-40 * steps, 40 * steps + 1)
    on_stair = np.diff(ndtr(edges / steps))
    reference = float(on_stair @ ndtr(-(level - edges[:-1]) / steps))

    def crash(x: Rows) -> Outcomes:
        return np.asarray(np.floor(steps * x).sum(axis=1) >= level)

    return Benchmark(traffic, order_of(traffic, *["increasing"] * 2), crash, reference)


def pocket(level: float = 4.0, radius: float = 0.45) -> Benchmark:
    """A half-plane without a disc behind its edge, 16 % of it; no order declared."""
    from scipy.special import ndtr
    from scipy.stats import ncx2

    center = np.array([level + radius + 0.05, 0.6])  # the disc leaves a strip of crashes before it
    in_disc = float(ncx2.cdf(radius**2, 2, center @ center))

    def crash(x: Rows) -> Outcomes:
        in_pocket = ((x - center) ** 2).sum(axis=1) <= radius**2
        return (x[:, 0] >= level) & ~in_pocket

    return Benchmark(standard_normal(2), None, crash, float(ndtr(-level)) - in_disc)


def strip(nearest: float = 3.5, farthest: float = 3.8) -> Benchmark:
    """Two standard normals between two parallel oblique lines; no order declared."""
    from scipy.special import ndtr

    def crash(x: Rows) -> Outcomes:
        across = x.sum(axis=1) / math.sqrt(2)
        return (across >= nearest) & (across <= farthest)

    reference = float(ndtr(-nearest) - ndtr(-farthest))
    return Benchmark(standard_normal(2), None, crash, reference)


def ring(nearest: float = 4.5, farthest: float = 4.8) -> Benchmark:
    """Two standard normals between two circles around the origin; no order declared."""

    def crash(x: Rows) -> Outcomes:
        radius = np.hypot(*x.T)
        return (radius >= nearest) & (radius <= farthest)

    reference = math.exp(-(nearest**2) / 2) - math.exp(-(farthest**2) / 2)
    return Benchmark(standard_normal(2), None, crash, reference)


def stripes(level: float = 3.8, width: float = 0.5) -> Benchmark:
    """A half-plane cut into stripes across its edge, each second of which crashes; no order."""
    from scipy.special import ndtr

    def crash(x: Rows) -> Outcomes:
        return np.asarray((x[:, 0] >= level) & (np.floor(x[:, 1] / width) % 2 == 0))

    starts = width * np.arange(-80, 80, 2)
    share = float((ndtr(starts + width) - ndtr(starts)).sum())
    return Benchmark(standard_normal(2), None, crash, float(ndtr(-level)) * share)


def rare_ring(share: float = 1e-3, away: float = -12.0) -> Benchmark:
    """A half-plane, and a ring around a component of `share` of traffic far off; no order.

    Each component misses the other's crashes by more than ten standard deviations.
    """
    from scipy.special import ndtr

    centers = np.array([[0.0, 0.0], [away, away]])
    nearest, farthest, level = 2.8, 3.2, 4.5
    traffic = mixture((1 - share, share), centers, [np.eye(2)] * 2)

    def crash(x: Rows) -> Outcomes:
        radius = np.hypot(*(x - centers[1]).T)
        return (x[:, 0] >= level) | ((radius >= nearest) & (radius <= farthest))

    in_ring = math.exp(-(nearest**2) / 2) - math.exp(-(farthest**2) / 2)
    reference = (1 - share) * float(ndtr(-level)) + share * in_ring
    return Benchmark(traffic, None, crash, reference)


def denser(d: int, away: float, radius: float, level: float = 4.2) -> Benchmark:
    """A half-space, and on another side a ball where traffic is far denser; no order declared.

    (The two lie on different sides: both at once is impossible.)
    """
    from scipy.special import ndtr
    from scipy.stats import ncx2

    middle, normal = np.zeros(d), np.zeros(d)
    middle[0], normal[:2] = away, (-0.6, -0.8)

    def crash(x: Rows) -> Outcomes:
        inside = ((x - middle) ** 2).sum(axis=1) < radius**2
        return np.asarray(inside | (x @ normal > level))

    probability = float(ncx2.cdf(radius**2, d, away**2) + ndtr(-level))
    return Benchmark(standard_normal(d), None, crash, probability)


def holes(share: float, probability: float = 1e-5) -> Benchmark:
    """A half-plane of which cells of 0.05 standard deviations are safe, `share` of them at random.

    Reference: `cells.probability_with_holes`, the sum over the holes.
    """
    from scipy.special import ndtri

    traffic, level = standard_normal(2), -math.sqrt(2) * ndtri(probability)

    def crash(x: Rows) -> Outcomes:
        return (x.sum(axis=1) >= level) & ~in_hole(x, share)

    order = order_of(traffic, *["increasing"] * 2)
    return Benchmark(traffic, order, crash, probability_with_holes(level, share))


def random_outcome(probability: float = 1e-4, deviation: float = 0.3) -> Benchmark:
    """A half-plane whose edge is moved by normal noise at every simulation: crash or not by chance.

    The noise is a hash of the situation's bits: no two situations share theirs, and a situation has
    the same outcome in any order, batch or process; a simulation repeated would not tell more.
    Reference: exact, the noise adds its variance to that of the distance to the edge.
    """
    from scipy.special import ndtr, ndtri

    traffic, level = standard_normal(2), -ndtri(probability)

    def crash(x: Rows) -> Outcomes:
        distance = x.sum(axis=1) / math.sqrt(2) - level
        return np.asarray(uniform(x) < ndtr(distance / deviation))

    reference = float(ndtr(-level / math.hypot(1.0, deviation)))
    return Benchmark(traffic, order_of(traffic, *["increasing"] * 2), crash, reference)


def mostly_outside() -> Benchmark:
    """A component that has 1/1845 of its mass in the box of positive numbers, and 30 % of events.

    Reference: quadrature, `truncated_sum.sum_probability`.
    """
    weights, level = (0.7, 0.3), 7.2
    means, deviations = ((1.0, 1.0), (-4.0, 3.0)), (1.0, math.sqrt(1.5))
    covariances = [s * s * np.eye(2) for s in deviations]
    traffic = mixture(weights, means, covariances, lower=0.0)

    def crash(x: Rows) -> Outcomes:
        return np.asarray(x.sum(axis=1) >= level)

    parts = [sum_probability(level, m, (s, s)) for m, s in zip(means, deviations, strict=True)]
    reference = float(np.dot(weights, parts))
    return Benchmark(traffic, order_of(traffic, *["increasing"] * 2), crash, reference)


def never(*, ordered: bool = True) -> Benchmark:
    """Two standard normals and a vehicle that never crashes."""
    traffic = standard_normal(2)

    def crash(x: Rows) -> Outcomes:
        return np.zeros(len(x), dtype=bool)

    order = order_of(traffic, *["increasing"] * 2) if ordered else None
    return Benchmark(traffic, order, crash, 0.0)


def wrong_sign(probability: float = 1e-5) -> Benchmark:
    """A half-plane of two standard normals; the order has one of the two directions wrong."""
    from scipy.special import ndtri

    traffic, level = standard_normal(2), -math.sqrt(2) * ndtri(probability)

    def crash(x: Rows) -> Outcomes:
        return np.asarray(x.sum(axis=1) >= level)

    return Benchmark(traffic, order_of(traffic, "increasing", "decreasing"), crash, probability)


WIDER: Mapping[str, Callable[[], Benchmark]] = {
    "outside a ball, d = 2": lambda: outside_ball(2, 1e-5),
    "outside a ball, d = 3": lambda: outside_ball(3, 1e-4),
    "corner, d = 3": lambda: all_above(3, 1e-6),
    "corner, d = 4": lambda: all_above(4, 1e-8),
    "union, d = 3": lambda: any_above(3, 1e-6),
    "union, d = 5": lambda: any_above(5, 1e-5),
    "three half-planes": three_half_planes,
    "stairs": stairs,
    "pocket": pocket,
    "strip": strip,
    "ring": ring,
    "stripes": stripes,
    "rare ring": rare_ring,
    "dense disc": lambda: denser(2, 2.8, 0.65),
    "dense disc, small": lambda: denser(2, 3.0, 0.45),
    "dense ball, d = 3": lambda: denser(3, 3.0, 0.9),
    "holes in 0.1 %": lambda: holes(0.001),
    "holes in 1 %": lambda: holes(0.01),
    "holes in 10 %": lambda: holes(0.1),
    "random outcome": random_outcome,
    "mostly outside the box": mostly_outside,
    "never": never,
    "never, no order": lambda: never(ordered=False),
    "wrong sign": wrong_sign,
}
