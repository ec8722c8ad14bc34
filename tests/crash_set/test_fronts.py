import numpy as np
import pytest

from crashrate.crash_set.fronts import (
    above_any,
    below_any,
    insert_maximal,
    insert_minimal,
    maximal,
    minimal,
)


def brute_minimal(points):
    """Rows that no other distinct row is below."""
    rows = np.unique(points, axis=0)
    return rows[[(rows <= row).all(axis=1).sum() == 1 for row in rows]]


@pytest.mark.parametrize("m", [1, 2, 3, 5])
@pytest.mark.parametrize("levels", [4, 1000])
def test_minimal_and_maximal_agree_with_brute_force(m, levels):
    points = np.random.default_rng(m).integers(0, levels, (80, m)).astype(float)
    np.testing.assert_array_equal(minimal(points), brute_minimal(points))
    expected = -brute_minimal(-points)
    np.testing.assert_array_equal(np.unique(maximal(points), axis=0), np.unique(expected, axis=0))


@pytest.mark.parametrize("levels", [4, 1000])
def test_inserting_one_by_one_gives_the_same_fronts(levels):
    points = np.random.default_rng(0).integers(0, levels, (100, 3)).astype(float)
    low = high = points[:0]
    for point in points:
        low, high = insert_minimal(low, point), insert_maximal(high, point)
    np.testing.assert_array_equal(np.unique(low, axis=0), minimal(points))
    np.testing.assert_array_equal(np.unique(high, axis=0), np.unique(maximal(points), axis=0))


def test_above_and_below_any_agree_with_brute_force_across_blocks(monkeypatch):
    monkeypatch.setattr("crashrate.crash_set.fronts._BLOCK", 64)
    rng = np.random.default_rng(1)
    u, front = rng.integers(0, 5, (200, 3)).astype(float), rng.integers(0, 5, (7, 3)).astype(float)
    above = (u[:, None] >= front).all(axis=2).any(axis=1)
    below = (u[:, None] <= front).all(axis=2).any(axis=1)
    np.testing.assert_array_equal(above_any(u, front), above)
    np.testing.assert_array_equal(below_any(u, front), below)
    assert above.any()
    assert not above.all()


def test_nothing_is_above_an_empty_front():
    u, none = np.zeros((3, 2)), np.empty((0, 2))
    assert not above_any(u, none).any()
    assert not below_any(u, none).any()
    assert above_any(none, u).shape == (0,)
