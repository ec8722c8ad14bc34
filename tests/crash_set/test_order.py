import numpy as np
import pytest

from crashrate.crash_set.order import RiskOrder
from crashrate.errors import InvalidInputError
from crashrate.expressions import Expression

NAMES = ("v_lead", "inv_range", "inv_ttc")
LOWER, UPPER = np.array([5.0, 1 / 75, 0.0]), np.array([35.0, np.inf, np.inf])


@pytest.fixture
def order():
    closing = Expression("inv_ttc / inv_range", NAMES)
    gap = Expression("1 / inv_range", NAMES)
    return RiskOrder.from_mapping(
        {
            "v_lead": "decreasing",
            "closing_speed": (closing, "increasing"),
            "range": (gap, "decreasing"),
            "energy": (lambda x: x[:, 0] ** 2, "increasing"),
        },
        NAMES,
    )


def draw(n):
    return np.random.default_rng(0).uniform([5, 0.02, 0.0], [35, 0.5, 2.0], (n, 3))


def test_danger_grows_in_every_column(order):
    x = np.array([[20.0, 0.1, 0.5]])
    np.testing.assert_allclose(order(x), [[-20.0, 5.0, -10.0, 400.0]])
    assert order.names == ("v_lead", "closing_speed", "range", "energy")
    assert order.n_coordinates == 4


@pytest.mark.parametrize("k", [0, 1, 2])
def test_half_spaces_are_the_level_sets(order, k):
    x = draw(500)
    u = order(x)[:, k]
    level = float(np.median(u)) + 1e-6
    normal, offset = order.half_space(k, level, LOWER, UPPER)
    np.testing.assert_array_equal(x @ normal >= offset, u >= level)


def test_a_plain_function_has_no_half_space(order):
    assert order.half_space(3, 10.0, LOWER, UPPER) is None


def test_a_value_that_is_not_finite_names_coordinate_and_row(order):
    x = draw(5)
    x[3, 1] = 0.0
    with pytest.raises(InvalidInputError, match=r"'closing_speed'.*row 3 .*inv_range = 0"):
        order(x)


def test_shapes_are_checked(order):
    with pytest.raises(InvalidInputError, match=r"\(n, 3\)"):
        order(np.zeros((2, 2)))
    wrong = RiskOrder.from_mapping({"s": (lambda x: x, "increasing")}, NAMES)
    with pytest.raises(InvalidInputError, match=r"'s': expected .*one number per row"):
        wrong(np.zeros((2, 3)))


@pytest.mark.parametrize(
    ("risk", "message"),
    [
        ({}, "at least one coordinate"),
        ({"v_led": "decreasing"}, "did you mean 'v_lead'"),
        ({"v_lead": "down"}, r"risk\['v_lead'\]: expected 'increasing' or 'decreasing'"),
        ({"c": (lambda x: x[:, 0], "up")}, r"risk\['c'\]: expected 'increasing'"),
        ({"c": lambda x: x[:, 0]}, r"\(function, direction\)"),
        ({"c": ("inv_ttc", "increasing")}, r"\(function, direction\)"),
        ({"v_lead": None}, "got None. A variable left out is claimed not to matter"),
        (
            {"c": (Expression("v_lead", ("inv_ttc", "v_lead", "inv_range")), "increasing")},
            r"risk\['c'\]: expected an Expression of the traffic model's variables, in their order",
        ),
    ],
)
def test_bad_declarations_are_refused(risk, message):
    with pytest.raises(InvalidInputError, match=message):
        RiskOrder.from_mapping(risk, NAMES)
