"""Directions in which no risk coordinate changes."""

import numpy as np
import pytest

from crashrate.crash_set.blind import Blind
from crashrate.crash_set.order import RiskOrder
from crashrate.expressions import Expression
from crashrate.traffic.model import TrafficModel

NAMES = ("a", "b", "c")
A, B, C = np.eye(3)
MIXED = np.array([[1.0, 0.6, 0.0], [0.6, 2.0, -0.3], [0.0, -0.3, 0.5]])


def blind(risk, covariance=None, lower=-np.inf):
    covariance = np.eye(3) if covariance is None else covariance
    sides = [lower] * 3, [np.inf] * 3
    traffic = TrafficModel([1.0], [[1.0, 2.0, 3.0]], covariance[None], *sides, NAMES)
    return Blind.of(RiskOrder.from_mapping(risk, NAMES), traffic), traffic


def expression(text):
    return Expression(text, NAMES), "increasing"


@pytest.mark.parametrize(
    ("risk", "unseen"),
    [
        ({"a": "increasing", "b": "decreasing"}, [C]),
        ({"b": "increasing"}, [A, C]),
        ({"s": expression("a + 2 * c")}, [B, 2 * A - C]),
        ({"s": expression("a + b"), "t": expression("a + b + (a + b) ** 2")}, [C, A - B]),
        ({"s": expression("a + b"), "c": "increasing"}, [A - B]),
        ({"a": "increasing", "b": "increasing", "c": "increasing"}, []),
        ({"s": (lambda x: np.floor(2 * x[:, 0]), "increasing")}, [B, C]),
        (
            {"s": expression("a + b"), "t": (lambda x: np.exp(x[:, 0] + x[:, 1]), "increasing")},
            [C, A - B],
        ),
    ],
)
@pytest.mark.parametrize("covariance", [np.eye(3), MIXED])
def test_are_found_whatever_the_covariance(risk, unseen, covariance):
    found, traffic = blind(risk, covariance)
    assert found.n == len(unseen)
    np.testing.assert_allclose(found.directions.T @ found.directions, np.eye(found.n), atol=1e-9)
    ways = found.factor @ found.directions
    for way in unseen:
        along, *_ = np.linalg.lstsq(ways, way, rcond=None)
        np.testing.assert_allclose(ways @ along, way, atol=1e-5)
    x = traffic.sample(20, 3)
    order = RiskOrder.from_mapping(risk, NAMES)
    usual = found.undone(x)
    assert usual.shape == (20, 1 + found.n, 3)
    np.testing.assert_allclose(found.displaced(usual[:, 0]), 0.0, atol=1e-9)
    for k in range(usual.shape[1]):
        np.testing.assert_allclose(order(usual[:, k]), order(x), rtol=1e-5, atol=1e-6)


def test_what_hardly_changes_a_coordinate_counts_as_unseen():
    slight = expression("a + b + (a - b) / 100")
    assert blind({"s": expression("a + b"), "t": slight, "c": "increasing"})[0].n == 1
    told = expression("a + b + (a - b) / 5")
    assert blind({"s": expression("a + b"), "t": told, "c": "increasing"})[0].n == 0


@pytest.mark.parametrize(
    ("ends", "level"), [(np.minimum, 1), (np.minimum, 3), (np.maximum, 1), (np.maximum, 3)]
)
def test_a_plateau_hides_what_lies_on_it(ends, level):
    """b is 2 on average: of traffic, or of what lies far out, a good part is level."""
    clipped = (lambda x: ends(x[:, 1], level), "increasing")
    found, _ = blind({"a": "increasing", "b": clipped, "c": "increasing"})
    assert found.n == 1
    assert abs(found.directions[1, 0]) == pytest.approx(1)


def test_components_have_units_of_their_own():
    found, _ = blind({"a": "increasing"})
    inside = found.within(np.zeros(3), np.diag([1.0, 0.01, 4.0]))
    x = np.array([[5.0, 0.2, 0.0], [5.0, 0.0, 3.0]])
    np.testing.assert_allclose(np.abs(inside.displaced(x)).max(axis=1), [2.0, 1.5])
    np.testing.assert_allclose(inside.undone(x)[:, 0], [[5.0, 0.0, 0.0]] * 2, atol=1e-12)


def test_axes_are_kept_apart():
    found, _ = blind({"b": "increasing"})
    assert np.abs(found.directions).max(axis=0) == pytest.approx([1, 1])


def test_what_a_ratio_does_not_see_differs_from_place_to_place():
    found, _ = blind({"r": expression("b / a"), "c": "increasing"}, lower=0.2)
    assert found.n in {1, 2}
    assert np.abs(found.directions[2]).max() < 0.1  # but it is of a and b alone


def test_a_radius_sees_each_direction_somewhere_and_none_everywhere():
    found, _ = blind({"r": (lambda x: np.hypot(x[:, 0] - 1, x[:, 1] - 2), "increasing")})
    assert found.n == 3
