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
    ],
)
@pytest.mark.parametrize("covariance", [np.eye(3), MIXED])
def test_are_found_whatever_the_covariance(risk, unseen, covariance):
    found, traffic = blind(risk, covariance)
    assert found.n == len(unseen)
    np.testing.assert_allclose(found.directions.T @ found.directions, np.eye(found.n), atol=1e-9)
    ways = found.factor @ found.directions  # in the variables' own units
    for way in unseen:
        along, *_ = np.linalg.lstsq(ways, way, rcond=None)
        np.testing.assert_allclose(ways @ along, way, atol=1e-6)
    x = traffic.sample(20, 3)
    order = RiskOrder.from_mapping(risk, NAMES)
    np.testing.assert_allclose(order(found.undone(x)), order(x), atol=1e-6)
    np.testing.assert_allclose(found.displaced(found.undone(x)), 0.0, atol=1e-9)


def test_axes_are_kept_apart():
    found, _ = blind({"b": "increasing"})
    assert np.abs(found.directions).max(axis=0) == pytest.approx([1, 1])


def test_a_ratio_leaves_one_direction_inside_the_box():
    found, _ = blind({"r": expression("b / a"), "c": "increasing"}, lower=0.2)
    assert found.n == 1
    assert abs(found.directions[2, 0]) < 0.1


def test_a_radius_sees_each_direction_somewhere_and_none_everywhere():
    found, _ = blind({"r": (lambda x: np.hypot(x[:, 0] - 1, x[:, 1] - 2), "increasing")})
    assert found.n == 3
