import numpy as np
import pytest
from scipy.optimize import linprog, minimize

from crashrate.errors import InvalidInputError, NumericalError
from crashrate.sampling.active_set import LeastNorm, least_norm
from crashrate.sampling.dominating_points import (
    _require_kkt,
    dominating_point,
    kkt_residual,
)


def random_problem(rng):
    d, c = rng.integers(1, 7), rng.integers(1, 12)
    root = rng.standard_normal((d, d)) * np.exp(rng.uniform(-2, 2, (d, 1)))
    covariance = root @ root.T + 1e-3 * np.diag(np.diag(root @ root.T))
    normals = rng.standard_normal((c, d))
    if rng.random() < 0.5:  # parallel, repeated and vanishing normals
        normals = np.round(normals)
    inside = 5 * rng.standard_normal(d)
    offsets = normals @ inside - rng.exponential(1, c) * (rng.random(c) < 0.7)
    if rng.random() < 0.3:  # perhaps empty
        offsets = offsets + 2 * rng.standard_normal(c)
    return rng.standard_normal(d), covariance, normals, offsets


def is_empty(normals, offsets):
    found = linprog(np.zeros(normals.shape[1]), A_ub=-normals, b_ub=-offsets, bounds=(None, None))
    return found.status == 2


@pytest.mark.parametrize("seed", range(4))
def test_kkt_holds_on_random_polyhedra(seed):
    rng = np.random.default_rng(seed)
    n_empty = 0
    for _ in range(100):
        mean, covariance, normals, offsets = random_problem(rng)
        x = dominating_point(mean, covariance, normals, offsets)
        if x is None:
            n_empty += 1
            assert is_empty(normals, offsets)
            continue
        slack = normals @ x - offsets
        assert slack.min() > -1e-7 * (1 + np.abs(offsets).max())
        # stationarity, by an independent route: the gradient is a sum of active normals
        gradient = np.linalg.solve(covariance, x - mean)
        active = normals[slack < 1e-7 * (1 + np.abs(offsets))]
        found = linprog(
            np.repeat([0.0, 1.0], [len(active), 2 * len(mean)]),
            A_eq=np.hstack([active.T, np.eye(len(mean)), -np.eye(len(mean))]),
            b_eq=gradient,
        )
        misfit = found.x[len(active) :].sum()
        assert misfit < 1e-5 * (1 + np.abs(gradient).max())
    assert 0 < n_empty < 60


def test_agrees_with_slsqp():
    rng = np.random.default_rng(7)
    compared = 0
    while compared < 25:
        mean, covariance, normals, offsets = random_problem(rng)
        x = dominating_point(mean, covariance, normals, offsets)
        if x is None:
            continue
        precision = np.linalg.inv(covariance)
        precision /= np.trace(precision)

        def distance(y, mean=mean, precision=precision):
            return (y - mean) @ precision @ (y - mean)

        constraint = {"type": "ineq", "fun": lambda y, a=normals, b=offsets: a @ y - b}
        found = minimize(distance, x + 0.1, method="SLSQP", constraints=constraint)
        if found.success and (normals @ found.x - offsets).min() > -1e-9:
            compared += 1
            assert distance(x) <= distance(found.x) + 1e-7 * (1 + distance(x))


def test_known_answers():
    identity = np.eye(2)
    np.testing.assert_allclose(
        dominating_point([0, 0], identity, [[1, 0], [0, 1]], [2, -1]), [2.0, 0.0]
    )
    # correlated: the densest point of {x_1 >= 2} carries x_2 along
    np.testing.assert_allclose(
        dominating_point([0, 0], [[1, 0.5], [0.5, 1]], [[1, 0]], [2]), [2.0, 1.0]
    )
    np.testing.assert_allclose(dominating_point([3, 4], identity, [[1, 0]], [-np.inf]), [3, 4])
    np.testing.assert_allclose(dominating_point([3], [[4]], np.empty((0, 1)), []), [3])


def test_an_empty_polyhedron_has_none():
    assert dominating_point([0], [[1]], [[1], [-1]], [1, 0]) is None
    assert dominating_point([0], [[1]], [[1]], [np.inf]) is None
    assert dominating_point([0], [[1]], [[0]], [1]) is None
    assert dominating_point([0], [[1]], [[0]], [-1]) is not None


def test_a_polyhedron_that_is_one_point_is_not_empty():
    rng = np.random.default_rng(5)
    for d in (2, 3, 5):
        vertex, normals = rng.standard_normal(d), rng.standard_normal((2 * d, d))
        normals = np.vstack([normals, -normals])
        x = dominating_point(np.zeros(d), np.eye(d), normals, normals @ vertex)
        np.testing.assert_allclose(x, vertex, atol=1e-9)


def test_scales_that_differ_by_ten_orders_of_magnitude():
    scale = np.array([1e-5, 1.0, 1e5])
    correlation = np.array([[1, 0.4, 0.2], [0.4, 1, -0.3], [0.2, -0.3, 1]])
    plain = dominating_point(np.zeros(3), correlation, np.eye(3), [3, -1, 2])
    scaled = dominating_point(
        np.zeros(3), correlation * np.outer(scale, scale), np.eye(3), [3, -1, 2] * scale
    )
    np.testing.assert_allclose(scaled, plain * scale, rtol=1e-10)


def test_the_check_refuses_a_wrong_answer():
    normals, offsets = np.eye(2), np.array([2.0, 1.0])
    right = least_norm(normals, offsets)
    assert kkt_residual(right, normals, offsets) < 1e-15
    wrong = LeastNorm(right.z + np.array([0.0, 1e-6]), right.multipliers)
    with pytest.raises(NumericalError, match="optimality conditions"):
        _require_kkt(wrong, normals, offsets)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([0, 0], np.eye(2), [[1, 0]], [1, 2]), "expected mean"),
        (([0, 0], -np.eye(2), [[1, 0]], [1]), "positive definite"),
        (([0, 0], np.eye(2), [[1, 0]], [np.nan]), "finite"),
        (([np.inf, 0], np.eye(2), [[1, 0]], [1]), "finite"),
    ],
)
def test_bad_problems_are_refused(arguments, message):
    with pytest.raises(InvalidInputError, match=message):
        dominating_point(*arguments)
