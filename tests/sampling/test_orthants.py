import numpy as np
import pytest
from scipy.optimize import minimize

from crashrate.crash_set.monotone_set import MonotoneSet
from crashrate.crash_set.order import RiskOrder
from crashrate.errors import InvalidInputError
from crashrate.expressions import Expression
from crashrate.sampling.curved import CurvedConstraint, curved_dominating_point
from crashrate.sampling.dominating_points import Whitening, dominating_point
from crashrate.sampling.orthants import dominating_points, orthant_constraints
from crashrate.traffic.model import TrafficModel

NAMES = ("v_lead", "inv_range", "inv_ttc")


@pytest.fixture(scope="module")
def traffic():
    return TrafficModel(
        weights=[0.7, 0.3],
        means=[[20.0, 0.05, 0.1], [15.0, 0.1, 0.05]],
        covariances=[
            np.diag([5.0, 0.03, 0.1]) ** 2,
            np.diag([4.0, 0.05, 0.2])
            @ [[1, 0.3, 0], [0.3, 1, 0.4], [0, 0.4, 1]]
            @ np.diag([4.0, 0.05, 0.2]),
        ],
        lower=[5.0, 1 / 75, 0.0],
        upper=[35.0, np.inf, np.inf],
        names=NAMES,
    )


def risk(closing):
    return {
        "v_lead": "decreasing",
        "closing_speed": (closing, "increasing"),
        "range": (Expression("1 / inv_range", NAMES), "decreasing"),
    }


@pytest.fixture(scope="module")
def exact():
    return RiskOrder.from_mapping(risk(Expression("inv_ttc / inv_range", NAMES)), NAMES)


@pytest.fixture(scope="module")
def curved():
    """The same order, its closing speed a plain function."""
    return RiskOrder.from_mapping(risk(lambda x: x[:, 2] / x[:, 1]), NAMES)


APEXES = np.array([[-12.0, 8.0, -10.0], [-30.0, 12.0, -6.0], [-8.0, -np.inf, -20.0]])


def test_points_lie_in_their_orthant_and_box(traffic, exact):
    found = dominating_points(traffic, exact, APEXES)
    assert len(found.points) == 6
    assert found.n_unsolved == 0
    u = exact(found.points)
    assert (u >= found.apexes[found.orthant] * (1 - np.sign(APEXES[found.orthant]) * 1e-9)).all()
    assert traffic.contains(found.points + np.array([0, 0, 1e-12])).all()
    np.testing.assert_array_equal(found.of_component(1), found.points[found.component == 1])


def test_no_point_of_the_orthant_is_denser(traffic, exact):
    """Against random points of the orthant, and against SLSQP in the raw variables."""
    found = dominating_points(traffic, exact, APEXES[:1])
    draws = np.random.default_rng(0).uniform([5, 0.1, 0.0], [12, 0.3, 4.0], (100_000, 3))
    draws = draws[(exact(draws) >= APEXES[0]).all(axis=1)]
    assert len(draws) > 1000
    for x, i in zip(found.points, found.component, strict=True):
        precision = np.linalg.inv(traffic.covariances[i])

        def squared(y, i=i, precision=precision):
            return np.einsum("...i,ij,...j", y - traffic.means[i], precision, y - traffic.means[i])

        assert squared(x) <= squared(draws).min() + 1e-9
        assert squared(draws).min() < squared(x) + 8.0  # the draws come close
        slsqp = minimize(
            squared,
            draws[0],
            method="SLSQP",
            bounds=[(5, 35), (1 / 75, None), (0, None)],
            constraints={"type": "ineq", "fun": lambda y: exact(y[None])[0] - APEXES[0]},
        )
        assert squared(x) == pytest.approx(slsqp.fun, rel=1e-5)


def test_curved_constraints_reach_the_exact_points(traffic, exact, curved):
    expected = dominating_points(traffic, exact, APEXES)
    found = dominating_points(traffic, curved, APEXES)
    assert found.n_unsolved == 0
    np.testing.assert_allclose(found.points, expected.points, rtol=2e-4, atol=2e-5)


def test_an_orthant_outside_the_box_is_counted_as_unsolved(traffic, exact):
    found = dominating_points(traffic, exact, [[0.0, 8.0, -10.0], APEXES[0]])
    assert found.n_unsolved == 2
    assert set(found.orthant.tolist()) == {1}


def test_known_points_are_taken_over(traffic, exact, monkeypatch):
    known = dominating_points(traffic, exact, APEXES)
    monkeypatch.setattr("crashrate.sampling.orthants._solve", None)
    again = dominating_points(traffic, exact, APEXES[[2, 0]], known)
    for j, old in enumerate([2, 0]):
        np.testing.assert_array_equal(
            again.points[again.orthant == j], known.points[known.orthant == old]
        )
    np.testing.assert_array_equal(again.log_masses[again.orthant == 1], known.log_masses[:2])


def test_first_corner_gives_the_means_or_their_projection_on_the_box(traffic, exact):
    found = dominating_points(traffic, exact, MonotoneSet.empty(3).corners)
    np.testing.assert_allclose(found.points, traffic.means, rtol=1e-12)


def test_constraints_are_exact_for_linear_fractional_coordinates(traffic, exact, curved):
    orthant = orthant_constraints(exact, APEXES[0], traffic)
    assert orthant.curved == ()
    assert len(orthant_constraints(curved, APEXES[0], traffic).curved) == 1
    x = np.random.default_rng(1).uniform([5, 0.02, 0], [35, 0.3, 4], (2000, 3))
    inside = (x @ orthant.normals.T >= orthant.offsets).all(axis=1)
    np.testing.assert_array_equal(inside, (exact(x) >= APEXES[0]).all(axis=1))
    assert 0 < inside.sum() < 2000


def test_a_curved_answer_that_fails_the_check_is_not_taken(monkeypatch):
    component = Whitening.of(np.zeros(2), np.eye(2))
    disc = CurvedConstraint(lambda x: 1 - ((x - [4.0, 1.5]) ** 2).sum(axis=1), 0.0)
    none = (np.empty((0, 2)), np.empty(0))
    right = curved_dominating_point(component, *none, (disc,), start=np.zeros(2))
    center = np.array([4.0, 1.5])
    np.testing.assert_allclose(right, center * (1 - 1 / np.linalg.norm(center)), atol=1e-4)
    for wrong in (right * 1.01, right * 0.99, np.array([4.0, 0.5])):
        monkeypatch.setattr("crashrate.sampling.curved._slsqp", lambda *_, w=wrong: w)
        assert curved_dominating_point(component, *none, (disc,), start=np.zeros(2)) is None


def test_agrees_with_single_calls(traffic, exact):
    found = dominating_points(traffic, exact, APEXES[1:2])
    orthant = orthant_constraints(exact, APEXES[1], traffic)
    for x, i in zip(found.points, found.component, strict=True):
        single = dominating_point(
            traffic.means[i], traffic.covariances[i], orthant.normals, orthant.offsets
        )
        np.testing.assert_allclose(x, single)


def test_apexes_are_checked(traffic, exact):
    with pytest.raises(InvalidInputError, match=r"apexes: expected an array of shape \(n, 3\)"):
        dominating_points(traffic, exact, [[1.0, 2.0]])
    with pytest.raises(InvalidInputError, match="apexes: expected finite"):
        dominating_points(traffic, exact, [[1.0, np.nan, 2.0]])
