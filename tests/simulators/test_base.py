import numpy as np
import pytest

from crashrate.errors import SimulationError
from crashrate.simulators import AccAeb, AccAebSimulator, Simulator, check_outcomes
from crashrate.simulators.base import Simulator as Protocol


@pytest.mark.parametrize(
    "outcomes",
    [
        [True, False, True],
        np.array([1, 0, 1], dtype=np.int8),
        np.array([1.0, 0.0, 1.0], dtype=np.float32),
        (1.0, 0.0, True),
    ],
)
def test_outcomes_become_ones_and_zeros(outcomes):
    checked = check_outcomes(outcomes, 3)
    assert checked.dtype == np.float64
    np.testing.assert_array_equal(checked, [1.0, 0.0, 1.0])


def test_failed_simulations_stay_nan():
    np.testing.assert_array_equal(check_outcomes([np.nan, 0.0], 2), [np.nan, 0.0])
    assert check_outcomes([], 0).shape == (0,)


@pytest.mark.parametrize(
    ("outcomes", "message"),
    [
        ([0.0, 3.7, -1.0], r"got 3.7 at row 1 \(2 such outcomes of 3, dtype float64\).*margin"),
        ([True, False], r"shape \(3,\), got shape \(2,\) of dtype bool"),
        ([[1.0], [0.0], [1.0]], r"got shape \(3, 1\)"),
        (True, r"got shape \(\)"),
        (["crash", "safe", "safe"], "got dtype <U5"),
        ([None, True, False], "got dtype object"),
        ([1j, 0, 0], "got dtype complex128"),
        ([[1.0], [0.0, 1.0], []], "one outcome per row"),
        ([np.inf, 0.0, 0.0], "got inf"),
        ([2, 0, 1], "got 2 at row 0"),
        (None, "got None .does the function return"),
    ],
)
def test_anything_else_is_refused(outcomes, message):
    with pytest.raises(SimulationError, match=message) as caught:
        check_outcomes(outcomes, 3, "my simulator")
    assert "my simulator" in str(caught.value)


def test_anything_callable_is_a_simulator():
    assert Simulator is Protocol
    columns = dict.fromkeys(("v_lead", "range", "closing_speed"), np.sum)
    assert isinstance(AccAebSimulator(AccAeb(), columns), Simulator)
    assert not isinstance(AccAeb(), Simulator)
