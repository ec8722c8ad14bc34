"""Disjoint boxes: unions of orthants cut up so that their probabilities add up.

P(inner) and P(outer), the bounds that §V.B of the 2017 paper mentions, are then sums of box
probabilities, without sampling.
"""

from typing import NamedTuple

import numpy as np

from crashrate.crash_set.fronts import insert_minimal, minimal
from crashrate.variables import FloatArray

Interval = tuple[float, ...]


class Boxes(NamedTuple):
    """Boxes [lower, upper), both of shape (n, m); ends may be infinite."""

    lower: FloatArray
    upper: FloatArray


def boxes_above(points: FloatArray, open_axis: int = 0) -> Boxes:
    """The union of the orthants {u >= a} as disjoint boxes.

    Slabs along one coordinate are cut up in the others; a piece that stays the same in the next
    slab grows instead of starting anew, which leaves O(n) boxes for m <= 3.

    Parameters
    ----------
    points : (n, m) array
        The apexes a: minimal crashes, or corners (entries -inf allowed).
    open_axis : int
        A coordinate in which every box extends to +inf.

    Returns
    -------
    Boxes
    """
    m = points.shape[1]
    front = minimal(points)
    if not len(front):
        return Boxes(front, front)
    # the last axis of the recursion is sliced first, and its first axis stays open
    axes = [open_axis, *(k for k in range(m) if k != open_axis)]
    lower, upper = _decompose(front[:, axes])
    back = np.argsort(axes)
    return Boxes(lower[:, back], upper[:, back])


def boxes_below(points: FloatArray, open_axis: int = 0) -> Boxes:
    """The union of the orthants {u <= b} as disjoint boxes, up to their boundaries."""
    lower, upper = boxes_above(-points, open_axis)
    return Boxes(-upper, -lower)


def _decompose(front: FloatArray) -> Boxes:
    if front.shape[1] == 1:
        return Boxes(front.min(axis=0, keepdims=True), np.full((1, 1), np.inf))
    if front.shape[1] == 2:
        return _strips(front)
    return _slabs(front)


def _strips(front: FloatArray) -> Boxes:
    """A staircase (n, 2) as one strip for each of its points, open in the first coordinate."""
    lower = front[np.argsort(front[:, 1])]
    upper = np.full_like(lower, np.inf)
    upper[:-1, 1] = lower[1:, 1]
    return Boxes(lower, upper)


def _slabs(front: FloatArray) -> Boxes:
    """Sweep the last coordinate upwards: more and more points are active."""
    growing: dict[Interval, float] = {}
    done: list[tuple[Interval, float, float]] = []
    active = front[:0, :-1]
    for level in np.unique(front[:, -1]):
        for point in front[front[:, -1] == level, :-1]:
            active = insert_minimal(active, point)
        pieces = list(map(tuple, np.hstack(_decompose(active)).tolist()))
        now = {piece: growing.pop(piece, level) for piece in pieces}
        done += [(piece, start, level) for piece, start in growing.items()]
        growing = now
    done += [(piece, start, np.inf) for piece, start in growing.items()]
    ends = np.array([[*piece, start, stop] for piece, start, stop in done])
    m = front.shape[1] - 1
    return Boxes(ends[:, [*range(m), 2 * m]], ends[:, [*range(m, 2 * m), 2 * m + 1]])
