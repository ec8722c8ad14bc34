import numpy as np
import pytest

from crashrate.errors import InvalidInputError
from crashrate.expressions import Expression
from crashrate.recordings.severity import LEVELS, Severity

NAMES = ("v", "c")
CLOSING = Severity.multiplying("c", NAMES)


def crash(x):
    return x[:, 1] > 10.0


def test_only_what_is_declared_changes():
    x = np.array([[3.0, 4.0], [5.0, 6.0]])
    assert (CLOSING(x, 1.0) == x).all()
    assert (CLOSING(x, 2.0) == [[3.0, 8.0], [5.0, 12.0]]).all()
    assert (CLOSING(x, np.array([1.0, 3.0])) == [[3.0, 4.0], [5.0, 18.0]]).all()


def test_any_arithmetic_on_the_variables_and_the_factor():
    worse = Severity(NAMES, {"v": Expression("v - (severity - 1) * c", (*NAMES, "severity"))})
    assert worse(np.array([[30.0, 4.0]]), 2.5).tolist() == [[24.0, 4.0]]


def test_first_level_is_the_least_from_which_on_an_event_crashes():
    closing = np.array([11.0, 8.0, 6.0, 4.5, 1.0])
    x = np.column_stack([np.zeros(5), closing])
    assert CLOSING.first_levels(x, crash).tolist() == [0, 1, 3, 4, len(LEVELS)]


def test_a_crash_that_is_none_at_a_higher_level_does_not_count():
    x = np.array([[0.0, 11.0]])
    assert CLOSING.first_levels(x, lambda rows: (rows[:, 1] > 10) & (rows[:, 1] < 12)) == [5]


def test_critical_factor_is_where_the_crash_begins():
    x = np.column_stack([np.zeros(3), [20.0, 5.0, 2.5]])
    found = CLOSING.critical_factors(x, crash, 10.0)
    assert found == pytest.approx([1.0, 2.0, 4.0], rel=1e-3)  # the first crashes as it is


@pytest.mark.parametrize(
    ("changed", "levels", "said"),
    [
        ({}, LEVELS, "at least one variable"),
        ({"d": Expression("c", NAMES)}, LEVELS, "unknown variable 'd'"),
        ({"c": Expression("c", NAMES)}, (1.0,), "grow from 1"),
        ({"c": Expression("c", NAMES)}, (1.0, 2.0, 1.5), "grow from 1"),
        ({"c": Expression("c", NAMES)}, (1.3, 2.0), "grow from 1"),
    ],
)
def test_what_is_no_severity_is_refused(changed, levels, said):
    with pytest.raises(InvalidInputError, match=said):
        Severity(NAMES, changed, levels)
