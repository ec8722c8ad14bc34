import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from crashrate.crash_set.corners import corners_of
from crashrate.crash_set.fronts import above_any, maximal, minimal
from crashrate.crash_set.monotone_set import Label, MonotoneSet
from crashrate.errors import InvalidInputError


def points(m, levels=5, max_rows=25):
    """Points on a coarse grid, so that ties are common."""
    rows = st.integers(1, max_rows)
    return rows.flatmap(
        lambda n: arrays(np.float64, (n, m), elements=st.integers(0, levels).map(float))
    )


dimensions = st.integers(1, 4)
labelled = dimensions.flatmap(lambda m: st.tuples(points(m), points(m, max_rows=6), points(m)))


@settings(max_examples=150, deadline=None)
@given(labelled)
def test_inner_and_outer_bracket_every_monotone_truth(drawn):
    seen, generators, asked = drawn
    truth = above_any(asked, generators)
    s = MonotoneSet.empty(seen.shape[1]).add(seen, above_any(seen, generators))
    assert s.contradictions == 0
    assert np.all(s.in_inner(asked) <= truth)
    assert np.all(truth <= s.in_outer(asked))
    labels = s.classify(asked)
    np.testing.assert_array_equal(labels == Label.CRASH, s.in_inner(asked))
    np.testing.assert_array_equal(labels == Label.SAFE, ~s.in_outer(asked))
    np.testing.assert_array_equal(s.classify(seen), above_any(seen, generators))


@settings(max_examples=150, deadline=None)
@given(dimensions.flatmap(points), st.randoms(use_true_random=False))
def test_any_labels_in_any_order_give_the_fronts_of_the_uncontradicted(u, random):
    crash = np.array([random.random() < 0.5 for _ in u])
    below = (u[:, None] <= u).all(axis=2)
    against = below & crash[:, None] & ~crash
    bad = against.any(axis=1) | against.any(axis=0)
    shuffled = random.sample(range(len(u)), len(u))
    s = MonotoneSet.empty(u.shape[1]).add(u[shuffled], crash[shuffled])
    assert s.contradictions == bad.sum()
    np.testing.assert_array_equal(minimal(s.minimal_crashes), minimal(u[crash & ~bad]))
    safe = maximal(u[~crash & ~bad])
    np.testing.assert_array_equal(minimal(s.maximal_safe), minimal(safe))
    np.testing.assert_array_equal(minimal(s.corners), minimal(corners_of(safe)))


@settings(max_examples=60, deadline=None)
@given(dimensions.flatmap(lambda m: st.tuples(points(m), points(m))))
def test_the_corners_cover_the_outer_set_and_nothing_inside_its_complement(drawn):
    seen, asked = drawn
    s = MonotoneSet.empty(seen.shape[1]).add(seen, np.zeros(len(seen), bool))
    covered = above_any(asked, s.corners)
    assert np.all(s.in_outer(asked) <= covered)
    # strictly below a safe point in every coordinate: off the common boundary
    strictly = (asked[:, None] < s.maximal_safe).all(axis=2).any(axis=1)
    assert not (covered & strictly).any()


def test_a_point_that_is_both_crash_and_safe_contradicts_itself():
    s = MonotoneSet.empty(2).add([[1.0, 1.0], [1.0, 1.0]], [True, False])
    assert s.contradictions == 2
    assert len(s.minimal_crashes) == len(s.maximal_safe) == 0
    assert s.classify([[1.0, 1.0]])[0] == Label.UNDECIDED
    assert len(s.u) == 2


def test_contradicted_labels_leave_fronts_and_corners_that_they_shaped():
    s = MonotoneSet.empty(2).add([[0.0, 3.0], [3.0, 0.0]], [False, False])
    assert len(s.corners) == 3
    s = s.add([-1.0, 2.0], True)
    assert s.contradictions == 2
    np.testing.assert_array_equal(s.maximal_safe, [[3.0, 0.0]])
    assert len(s.corners) == 2
    assert len(s.minimal_crashes) == 0


def test_points_equal_to_a_label_get_it():
    s = MonotoneSet.empty(2).add([[1.0, 1.0], [0.0, 0.0]], [True, False])
    asked = [[1.0, 1.0], [0.0, 0.0], [1.0, 0.5]]
    assert s.classify(asked).tolist() == [Label.CRASH, Label.SAFE, Label.UNDECIDED]
    assert s.classify(asked).dtype == np.int8


def test_adding_returns_a_new_read_only_value():
    empty = MonotoneSet.empty(2)
    s = empty.add([0.0, 0.0], True)
    assert len(empty.u) == 0
    assert len(s.minimal_crashes) == 1
    with pytest.raises(ValueError, match="read-only"):
        s.minimal_crashes[0, 0] = 3.0
    assert s.add(np.empty((0, 2)), []) is s


@pytest.mark.parametrize(
    ("u", "crash", "message"),
    [
        ([[0.0, 0.0, 0.0]], [True], r"u: expected an array of shape \(n, 2\)"),
        ([[0.0, np.nan]], [True], "row 0, column 1"),
        ([[0.0, 0.0]], [True, False], r"one label per point, shape \(1,\)"),
        ([[0.0, 0.0]], [1.0], "expected booleans"),
    ],
)
def test_bad_labels_are_refused(u, crash, message):
    with pytest.raises(InvalidInputError, match=message):
        MonotoneSet.empty(2).add(u, crash)


def test_no_coordinates_is_refused():
    with pytest.raises(InvalidInputError, match="at least one"):
        MonotoneSet.empty(0)
