import numpy as np
import pytest
from scipy.stats import norm

from crashrate.crash_set.bounds import orthants_probability, probability_bounds
from crashrate.crash_set.monotone_set import MonotoneSet
from crashrate.crash_set.order import RiskOrder
from crashrate.errors import NumericalError
from crashrate.expressions import Expression
from crashrate.traffic.model import TrafficModel

NAMES = ("v_lead", "inv_range", "inv_ttc")


@pytest.fixture(scope="module")
def normal():
    return TrafficModel([1.0], [np.zeros(2)], [np.eye(2)], [-np.inf] * 2, [np.inf] * 2, ("a", "b"))


@pytest.fixture(scope="module")
def traffic():
    spread = np.diag([5.0, 0.03, 0.2])
    return TrafficModel(
        weights=[0.7, 0.3],
        means=[[20.0, 0.05, 0.1], [15.0, 0.1, 0.05]],
        covariances=[
            spread @ [[1, 0.3, 0], [0.3, 1, 0.4], [0, 0.4, 1]] @ spread,
            spread @ [[1, 0, 0.2], [0, 1, -0.4], [0.2, -0.4, 1]] @ spread,
        ],
        lower=[5.0, 1 / 75, 0.0],
        upper=[35.0, np.inf, np.inf],
        names=NAMES,
    )


def risk(closing):
    return RiskOrder.from_mapping(
        {
            "v_lead": "decreasing",
            "closing_speed": (closing, "increasing"),
            "range": (Expression("1 / inv_range", NAMES), "decreasing"),
        },
        NAMES,
    )


@pytest.fixture(scope="module")
def oblique():
    return risk(Expression("inv_ttc / inv_range", NAMES))


def test_two_orthants_of_a_normal_are_exact_and_relative(normal):
    order = RiskOrder.from_mapping({"a": "increasing", "b": "decreasing"}, ("a", "b"))
    t, s = norm.sf([4, 6]), norm.cdf([-5, -4])  # {a >= 4, b <= -5} and {a >= 6, b <= -4}
    expected = t[0] * s[0] + t[1] * (s[1] - s[0])
    got = orthants_probability(np.array([[4.0, 5.0], [6.0, 4.0]]), order, normal)
    assert got == pytest.approx(expected, rel=1e-9)


def test_bounds_of_a_half_space_bracket_and_close_in(normal):
    order = RiskOrder.from_mapping({"a": "increasing", "b": "increasing"}, ("a", "b"))
    p = norm.sf(3 * np.sqrt(2))  # a + b >= 6
    rng = np.random.default_rng(0)
    learned, widths = MonotoneSet.empty(2), []
    assert probability_bounds(learned, order, normal) == pytest.approx((0.0, 1.0))
    for _ in range(4):
        a = rng.uniform(-1, 7, 60)
        u = np.stack([a, 6 - a + 0.1 * rng.standard_normal(60)], axis=1)
        learned = learned.add(u, u.sum(axis=1) >= 6)
        low, high = probability_bounds(learned, order, normal)
        assert low < p < high
        widths.append(high - low)
    assert np.all(np.diff(widths) < 0)
    assert widths[-1] < p


def test_a_variable_that_is_no_risk_coordinate_is_integrated_out(traffic):
    order = RiskOrder.from_mapping({"v_lead": "decreasing"}, NAMES)
    expected = traffic.box_probability([5, -np.inf, -np.inf], [12, np.inf, np.inf])
    got = orthants_probability(np.array([[-12.0], [-10.0]]), order, traffic)
    assert got == pytest.approx(float(expected), rel=1e-9)


def test_an_oblique_coordinate_agrees_with_monte_carlo(traffic, oblique):
    apexes = np.array([[-22.0, 3.0, -25.0], [-15.0, -np.inf, -20.0], [-20.0, 5.0, -40.0]])
    got = orthants_probability(apexes, oblique, traffic)
    u = oblique(traffic.sample(200_000, 1))
    inside = (u[:, None] >= apexes).all(axis=2).any(axis=1)
    assert got == pytest.approx(inside.mean(), abs=4 * inside.std() / np.sqrt(len(u)))


def test_bounds_of_random_labels_bracket_monte_carlo_with_an_oblique_coordinate(traffic, oblique):
    x = traffic.sample(300, 2)
    u = oblique(x)
    crash = (u / [5, 3, 10]).sum(axis=1) > -3
    learned = MonotoneSet.empty(3).add(u, crash)
    low, high = probability_bounds(learned, oblique, traffic)
    v = oblique(traffic.sample(100_000, 3))
    inner, outer = learned.in_inner(v), learned.in_outer(v)
    assert low == pytest.approx(inner.mean(), abs=4 * inner.std() / np.sqrt(len(v)))
    assert high == pytest.approx(outer.mean(), abs=4 * outer.std() / np.sqrt(len(v)))


def test_unknown_level_sets_have_no_exact_bounds(traffic):
    order = risk(lambda x: x[:, 2] / x[:, 1])
    learned = MonotoneSet.empty(3).add([-22.0, 3.0, -25.0], True)
    assert probability_bounds(learned, order, traffic) is None
    two = RiskOrder.from_mapping(
        {
            "a": (Expression("v_lead + inv_ttc", NAMES), "increasing"),
            "b": (Expression("v_lead + inv_range", NAMES), "increasing"),
        },
        NAMES,
    )
    learned = MonotoneSet.empty(2).add([22.0, 3.0], True)
    assert probability_bounds(learned, two, traffic) is None


def test_a_slope_too_steep_for_the_box_probabilities_has_no_exact_bounds(
    traffic, oblique, monkeypatch
):
    def unsettled(*_):
        raise NumericalError("box probability: had not settled")

    learned = MonotoneSet.empty(3).add([-22.0, 3.0, -25.0], True)
    assert probability_bounds(learned, oblique, traffic) is not None
    monkeypatch.setattr("crashrate.crash_set.bounds.log_box_probability", unsettled)
    assert probability_bounds(learned, oblique, traffic) is None
