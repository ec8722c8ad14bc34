import itertools

import numpy as np
import pytest

from crashrate.crash_set.corners import corners_of, cut, first_corner
from crashrate.crash_set.fronts import maximal, minimal


def brute_corners(safe):
    """The 2017 paper's union over d^n0 index choices, and its minimal elements."""
    n, m = safe.shape
    corners = np.full((m**n, m), -np.inf)
    for row, choice in zip(corners, itertools.product(range(m), repeat=n), strict=True):
        for point, k in zip(safe, choice, strict=True):
            row[k] = max(row[k], point[k])
    return minimal(corners)


def antichain(n, m, rng):
    """n points in general position, none above another."""
    u = rng.standard_normal((n, m))
    return u - u.sum(axis=1, keepdims=True) / m


@pytest.mark.parametrize("m", [1, 2, 3, 4, 5, 6])
@pytest.mark.parametrize("levels", [3, 6, 10**6])
def test_corners_equal_brute_force_enumeration(m, levels):
    rng = np.random.default_rng(m * levels)
    for n in range(1, 7 if m < 5 else 6):
        safe = rng.integers(0, levels, (n, m)).astype(float)
        found = corners_of(safe)
        assert len(np.unique(found, axis=0)) == len(found)
        np.testing.assert_array_equal(minimal(found), brute_corners(safe))


def test_dropping_the_tie_rule_would_be_noticed():
    """Negative control: children alone, not compared with old corners on the cut, are too many."""
    safe = np.array([[0.0, 2.0, 2.0], [2.0, 1.0, 2.0], [2.0, 2.0, 1.0], [2.0, 0.0, 3.0]])
    wrong = first_corner(3)
    for b in safe:
        hit = (wrong < b).all(axis=1)
        children = np.repeat(wrong[hit], 3, axis=0)
        children[np.arange(len(children)), np.arange(len(children)) % 3] = np.tile(b, hit.sum())
        wrong = np.vstack([wrong[~hit], minimal(children)])
    assert len(wrong) > len(brute_corners(safe))
    np.testing.assert_array_equal(minimal(corners_of(safe)), brute_corners(safe))


@pytest.mark.parametrize(("m", "expected"), [(1, 1), (2, 57), (3, 113)])
def test_number_of_corners_in_general_position(m, expected):
    safe = antichain(56, m, np.random.default_rng(0)) if m > 1 else np.arange(56.0)[:, None]
    assert len(corners_of(safe)) == expected


def test_order_of_the_safe_points_does_not_matter():
    rng = np.random.default_rng(3)
    safe = rng.integers(0, 9, (30, 4)).astype(float)
    np.testing.assert_array_equal(
        minimal(corners_of(safe)), minimal(corners_of(rng.permutation(safe)))
    )
    np.testing.assert_array_equal(minimal(corners_of(safe)), minimal(corners_of(maximal(safe))))


def test_a_dominated_or_repeated_safe_point_changes_nothing():
    corners = corners_of(np.array([[1.0, 2.0], [2.0, 1.0]]))
    assert cut(corners, np.array([1.0, 1.0])) is corners
    assert cut(corners, np.array([2.0, 1.0])) is corners


def test_three_hundred_safe_points_have_six_hundred_and_one_corners():
    safe = antichain(300, 3, np.random.default_rng(0))
    corners = corners_of(safe)
    assert len(corners) == 601
