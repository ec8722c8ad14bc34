"""P(inner) and P(outer), exactly: the bounds on the crash probability that §V.B mentions.

Both sets are cut into disjoint boxes of risk coordinates. Where a risk coordinate is monotone in
one variable its boxes are boxes of that variable; one coordinate may be oblique, its level sets
half-spaces in several variables: all boxes are open in it, and a linear change of variables makes
each of them a box again.
"""

from dataclasses import dataclass

import numpy as np

from crashrate.crash_set.boxes import Boxes, boxes_above
from crashrate.crash_set.monotone_set import MonotoneSet
from crashrate.crash_set.order import RiskOrder
from crashrate.errors import NumericalError
from crashrate.expressions import HalfSpace
from crashrate.traffic.model import TrafficModel
from crashrate.traffic.truncated_normal import log_box_probability
from crashrate.variables import BoolArray, FloatArray


def probability_bounds(
    learned: MonotoneSet, order: RiskOrder, traffic: TrafficModel
) -> tuple[float, float] | None:
    """P(inner) <= p <= P(outer) under the traffic model, without sampling.

    Valid if the order is. Sums of positive terms: the accuracy is relative.

    Parameters
    ----------
    learned : MonotoneSet
        In the coordinates of `order`.
    order : RiskOrder
        On the traffic model's variables.
    traffic : TrafficModel

    Returns
    -------
    (float, float) or None
        None where the risk coordinates have level sets of another kind, or a slope is too steep
        for the box probabilities.
    """
    inner = orthants_probability(learned.minimal_crashes, order, traffic)
    outer = orthants_probability(learned.corners, order, traffic)
    if inner is None or outer is None:
        return None
    return min(inner, 1.0), min(outer, 1.0)  # sums round


def orthants_probability(
    apexes: FloatArray, order: RiskOrder, traffic: TrafficModel
) -> float | None:
    """Probability of the union of the orthants {x: u(x) >= apex}, apexes (n, m); None as above."""
    if not len(apexes):
        return 0.0
    oblique: list[int] = []
    for k in range(order.n_coordinates):
        levels = apexes[np.isfinite(apexes[:, k]), k]
        normals = _normals(order, k, levels, traffic)
        if normals is None:
            return None
        if (np.count_nonzero(normals, axis=1) > 1).any():
            oblique.append(k)
    if len(oblique) > 1:
        return None
    if not oblique:
        frame = _straight(boxes_above(apexes), order, traffic, skip=None)
        return float(traffic.box_probability(frame.lower, frame.upper).sum())
    boxes = boxes_above(apexes, open_axis=oblique[0])
    frame = _straight(boxes, order, traffic, skip=oblique[0])
    return _oblique_probability(frame, boxes.lower[:, oblique[0]], order, oblique[0], traffic)


def _normals(
    order: RiskOrder, k: int, levels: FloatArray, traffic: TrafficModel
) -> FloatArray | None:
    """Normals (n, d) of the level sets of coordinate k, or None where one is not a half-space."""
    found = [order.half_space(k, float(v), traffic.lower, traffic.upper) for v in levels]
    normals = [h.normal for h in found if h is not None]
    if len(normals) < len(found):
        return None
    return np.reshape(normals, (len(normals), traffic.n_variables))


def _straight(boxes: Boxes, order: RiskOrder, traffic: TrafficModel, skip: int | None) -> Boxes:
    """The boxes in the variables, all coordinates but `skip` being monotone in one of them."""
    n = len(boxes.lower)
    cut = Boxes(np.tile(traffic.lower, (n, 1)), np.tile(traffic.upper, (n, 1)))
    for k in range(order.n_coordinates):
        if k == skip:
            continue
        for side, beyond in ((boxes.lower[:, k], False), (boxes.upper[:, k], True)):
            for level in np.unique(side[np.isfinite(side)]):
                half_space = order.half_space(k, float(level), traffic.lower, traffic.upper)
                if half_space is not None:  # never None: `_normals` looked at them all
                    _cut(cut, side == level, half_space, beyond=beyond)
    return cut


def _cut(boxes: Boxes, rows: BoolArray, half_space: HalfSpace, *, beyond: bool) -> None:
    """Keep of the boxes `rows`, in place, what is in the half-space, or what is beyond it."""
    lower, upper = boxes
    normal, offset = half_space.normal, half_space.offset
    if not normal.any():  # a constant coordinate: all of space or nothing
        if (offset > 0.0) != beyond:
            upper[rows] = lower[rows]
        return
    j = int(np.flatnonzero(normal)[0])
    if (normal[j] > 0.0) != beyond:
        lower[rows, j] = np.maximum(lower[rows, j], offset / normal[j])
    else:
        upper[rows, j] = np.minimum(upper[rows, j], offset / normal[j])


@dataclass(frozen=True)
class _Plane:
    """{normal @ x >= offset}, and the variable that normal @ x can stand for."""

    normal: FloatArray
    offset: float
    variable: int


def _oblique_probability(
    frame: Boxes, levels: FloatArray, order: RiskOrder, k: int, traffic: TrafficModel
) -> float | None:
    """Probability of boxes (of variables) cut by {u_k >= level}, a level (n,) for each box."""
    plain = ~np.isfinite(levels)
    total = float(traffic.box_probability(frame.lower[plain], frame.upper[plain]).sum())
    there = (frame.lower < frame.upper).all(axis=1)
    turned = []
    for n in np.flatnonzero(~plain & there):
        half_space = order.half_space(k, float(levels[n]), traffic.lower, traffic.upper)
        if half_space is None:
            return None
        lower, upper = frame.lower[n], frame.upper[n]
        plane = _replaceable(half_space.normal, half_space.offset, lower, upper)
        if plane is None:
            return None
        turned.append(_turned(plane, lower, upper, traffic))
    if not turned:
        return total
    means, covariances, lower, upper = (np.concatenate(part) for part in zip(*turned, strict=True))
    try:
        log_p = log_box_probability(means, covariances, lower, upper)
    except NumericalError:  # a slope so steep that two variables of the turned box are nearly one
        return None
    parts = np.exp(log_p.reshape(-1, traffic.n_components) - traffic.log_masses)
    return total + float((parts @ traffic.weights).sum())


def _replaceable(
    normal: FloatArray, offset: float, lower: FloatArray, upper: FloatArray
) -> _Plane | None:
    """A variable whose own sides do not cut the box once normal @ x >= offset holds in it."""
    for j in np.flatnonzero(normal):
        rising = normal[j] > 0.0
        far, near = (upper[j], lower[j]) if rising else (-lower[j], -upper[j])
        others = np.flatnonzero(normal)
        others = others[others != j]
        ends = normal[others] * np.stack([lower[others], upper[others]])
        # normal_j x_j >= offset - most of the rest
        least = (offset - ends.max(axis=0).sum()) / abs(normal[j])
        if far == np.inf and least >= near - 1e-12 * abs(near):
            return _Plane(normal, offset, int(j))
    return None


def _turned(
    plane: _Plane, lower: FloatArray, upper: FloatArray, traffic: TrafficModel
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Means, covariances and box, for every component, in variables with normal @ x among them."""
    turn = np.eye(traffic.n_variables)
    turn[plane.variable] = plane.normal
    lower, upper = lower.copy(), upper.copy()
    lower[plane.variable], upper[plane.variable] = plane.offset, np.inf
    n = traffic.n_components
    covariances = turn @ traffic.covariances @ turn.T
    return (
        traffic.means @ turn.T,
        (covariances + covariances.transpose(0, 2, 1)) / 2,
        np.tile(lower, (n, 1)),
        np.tile(upper, (n, 1)),
    )
