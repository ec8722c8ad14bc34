import numpy as np
import pytest

from crashrate.crash_set.boxes import boxes_above, boxes_below
from crashrate.crash_set.corners import corners_of
from crashrate.crash_set.fronts import above_any


def volume(boxes, top):
    return (np.minimum(boxes.upper, top) - boxes.lower).clip(0).prod(axis=1).sum()


def exact_volume(points, top):
    """Of the union of orthants {u >= a} below `top`, by inclusion and exclusion."""
    total = 0.0
    for subset in range(1, 2 ** len(points)):
        chosen = [i for i in range(len(points)) if subset >> i & 1]
        side = (top - points[chosen].max(axis=0)).clip(0).prod()
        total += (-1) ** (len(chosen) + 1) * side
    return total


@pytest.mark.parametrize("m", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("levels", [4, 10**6])
def test_boxes_are_disjoint_and_cover_the_union(m, levels):
    rng = np.random.default_rng(m)
    points = rng.integers(0, levels, (25, m)) / levels
    draws = rng.random((3000, m)) * 1.2
    for axis in range(m):
        boxes = boxes_above(points, axis)
        inside = (draws[:, None] >= boxes.lower) & (draws[:, None] < boxes.upper)
        times = inside.all(axis=2).sum(axis=1)
        np.testing.assert_array_equal(times, above_any(draws, points))
        assert np.isinf(boxes.upper[:, axis]).all()


@pytest.mark.parametrize("m", [2, 3, 4])
def test_volumes_are_exact(m):
    points = np.random.default_rng(m).random((9, m))
    assert volume(boxes_above(points), 1.0) == pytest.approx(exact_volume(points, 1.0), rel=1e-12)


def test_inner_box_volume_plus_complement_is_everything():
    safe = np.random.default_rng(0).random((20, 3))
    outer = boxes_above(corners_of(safe))
    below = boxes_below(safe)
    inside = (np.minimum(below.upper, 1) - np.maximum(below.lower, 0)).clip(0).prod(axis=1).sum()
    outside = (np.minimum(outer.upper, 1) - np.maximum(outer.lower, 0)).clip(0).prod(axis=1).sum()
    assert inside + outside == pytest.approx(1, rel=1e-12)


def test_the_number_of_boxes_grows_linearly_in_three_dimensions():
    u = np.random.default_rng(0).standard_normal((150, 3))
    u -= u.mean(axis=1, keepdims=True)
    assert len(boxes_above(u).lower) <= 2 * 150 + 1
    assert len(boxes_above(corners_of(u)).lower) == 301


def test_no_points_no_boxes():
    assert len(boxes_above(np.empty((0, 3))).lower) == 0
