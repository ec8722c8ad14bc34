"""What a simulator tells, with consequences: checked whole, refused with a remedy."""

import numpy as np
import pytest

from crashrate.errors import InvalidInputError, SimulationError
from crashrate.outcomes import consequence_names, outcome_table, told_table
from crashrate.simulators import check_outcomes

NAMES = ("injury", "severe")


def table(told, n=3, error=SimulationError):
    return outcome_table(told, n, NAMES, "the simulator", error)


def test_an_array_is_taken_as_it_is():
    rows = np.array([[1, 0.4, 1], [0, 0, 0], [1, 0, 0]])
    np.testing.assert_array_equal(table(rows), rows)
    assert table(rows.astype(np.float32)).dtype == np.float64


@pytest.mark.parametrize("event", ["crash", "near miss"])
def test_a_mapping_is_put_in_the_declared_order(event):
    told = {"severe": [True, False, False], event: [1, 0, 1], "injury": [0.4, 0, 0]}
    np.testing.assert_array_equal(table(told), [[1, 0.4, 1], [0, 0, 0], [1, 0, 0]])


def test_a_failed_run_is_unknown_throughout_and_the_array_told_is_not_changed():
    rows = np.array([[np.nan, 0.4, 1], [0, 0, 0], [1, 0, 0]])
    assert np.isnan(table(rows)[0]).all()
    assert rows[0, 1] == 0.4


@pytest.mark.parametrize(
    ("told", "says"),
    [
        (np.ones(3), r"expected shape \(3, 3\).*the event, injury, severe, got shape \(3,\)"),
        (np.ones((3, 2)), r"got shape \(3, 2\)"),
        ([[1, 0.2], [0]], r"shape \(3, 3\)"),
        (np.full((3, 3), "x"), "dtype <U1"),
        ({"crash": [0] * 3, "injury": [0] * 3}, "keys injury, severe and one more"),
        ({"a": [0] * 3, "b": [0] * 3, "injury": [0] * 3}, "got a, b, injury"),
        ([[2, 0, 0]] * 3, "got 2.0 at row 0"),
        ([[0, 0, 0], [1, 1.5, 0], [0, 0, 0]], r"'injury' in \[0, 1\], got 1.5 at row 1; divide"),
        ([[0, 0, 0], [1, 0, -1], [0, 0, 0]], r"'severe' in \[0, 1\], got -1.0 at row 1"),
        ([[1, np.nan, 0]] * 3, r"'injury' in \[0, 1\], got nan at row 0; return 0 where"),
        ({"c": [0] * 3, "injury": [0.5], "severe": [0] * 3}, r"3 values under 'injury'.*\(1,\)"),
        ([[0, 0, 0], [0, 0, 0], [0, 0.1, 0]], "got 0.1 at row 2; let the event be the widest"),
    ],
)
def test_what_is_no_outcome_is_refused_with_what_to_do(told, says):
    with pytest.raises(SimulationError, match=says):
        table(told)


def test_without_consequences_outcomes_are_a_column():
    np.testing.assert_array_equal(told_table([1, 0], 2, ()), [[1], [0]])
    np.testing.assert_array_equal(told_table({"crash": [1, 0]}, 2, ()), [[1], [0]])
    np.testing.assert_array_equal(check_outcomes({"crash": [True, False]}, 2), [1, 0])
    with pytest.raises(SimulationError, match="draw the outcome by it"):
        check_outcomes([0.7], 1)
    with pytest.raises(InvalidInputError, match="declare what it holds"):
        told_table({"crash": [1], "injury": [0.5]}, 1, ())


@pytest.mark.parametrize("names", ["injury", ("a", "a"), ("",), (1,)])
def test_names_are_different_texts(names):
    with pytest.raises(InvalidInputError, match="consequences: expected"):
        consequence_names(names)


@pytest.mark.parametrize("told", [[None, None], ["yes", "no"]])
def test_what_is_no_number_is_no_failed_simulation(told):
    with pytest.raises(InvalidInputError, match="NaN"):
        told_table(told, 2, ())
