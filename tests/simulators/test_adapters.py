import pickle

import numpy as np
import pytest

from crashrate.errors import InvalidInputError
from crashrate.expressions import Expression
from crashrate.simulators import AccAeb, AccAebSimulator

NAMES = ("v_lead", "inv_range", "inv_ttc")
DERIVED = {
    "range": Expression("1 / inv_range", NAMES),
    "closing_speed": Expression("inv_ttc / inv_range", NAMES),
}


def rows(n=500, seed=0):
    rng = np.random.default_rng(seed)
    gap = rng.uniform(2.0, 75.0, n)
    return np.stack([rng.uniform(5.0, 35.0, n), 1.0 / gap, rng.uniform(0.0, 30.0, n) / gap], axis=1)


def test_rows_of_the_paper_reach_the_plant_in_its_units():
    x = rows()
    simulate = AccAebSimulator.for_variables(AccAeb.published(), NAMES, DERIVED)
    result = AccAeb.published().run(
        v_lead=x[:, 0], range=1.0 / x[:, 1], closing_speed=x[:, 2] / x[:, 1]
    )
    np.testing.assert_array_equal(simulate(x), result.crash)
    np.testing.assert_array_equal(simulate.run(x).impact_speed, result.impact_speed)
    np.testing.assert_array_equal(simulate.altered(x), result.input_altered)
    assert 0 < simulate.altered(x).sum() < len(x)
    assert simulate(np.empty((0, 3))).shape == (0,)


def test_closing_speed_may_be_a_variable_itself():
    names = ("v_lead", "inv_range", "closing_speed")
    simulate = AccAebSimulator.for_variables(
        AccAeb(), names, {"range": Expression("1 / inv_range", names)}
    )
    x = np.array([[10.0, 0.5, 15.0], [10.0, 0.02, 1.0]])
    np.testing.assert_array_equal(simulate(x), [True, False])
    np.testing.assert_allclose(simulate.inputs(x)["range"], [2.0, 50.0])


def test_columns_may_be_any_functions():
    columns = {
        "closing_speed": lambda x: x[:, 1],
        "v_lead": lambda x: np.full(len(x), 10.0),
        "range": lambda x: x[:, 0],
    }
    simulate = AccAebSimulator(AccAeb(), columns)
    np.testing.assert_array_equal(simulate([[2.0, 15.0], [50.0, 1.0]]), [True, False])


def test_adapter_is_a_value_that_reaches_other_processes():
    simulate = AccAebSimulator.for_variables(AccAeb.published(), NAMES, DERIVED)
    copy = pickle.loads(pickle.dumps(simulate))  # noqa: S301
    assert copy == simulate
    assert hash(copy) == hash(simulate)
    np.testing.assert_array_equal(copy(rows()), simulate(rows()))


def test_missing_and_unknown_inputs_are_named():
    with pytest.raises(InvalidInputError, match=r"needs 'range', which is neither.*1 / inv_range"):
        AccAebSimulator.for_variables(AccAeb(), NAMES)
    with pytest.raises(InvalidInputError, match="unknown 'rang'; did you mean 'range'"):
        AccAebSimulator(AccAeb(), {"rang": np.sum})
    with pytest.raises(InvalidInputError, match="closing_speed is missing"):
        AccAebSimulator(AccAeb(), {"v_lead": np.sum, "range": np.sum})


def test_row_the_plant_cannot_start_from_is_refused():
    simulate = AccAebSimulator.for_variables(AccAeb(), NAMES, DERIVED)
    with pytest.raises(InvalidInputError, match="range: expected a finite range > 0 m, got inf"):
        simulate([[10.0, 0.0, 0.1]])
