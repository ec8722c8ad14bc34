import numpy as np
import pytest

from crashrate.traffic.natural import to_natural
from crashrate.traffic.truncated_components import Box, components_at, sound, usable

INF = np.inf


def a_component(d, seed=0):
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(d, d + 2))
    means = rng.normal(size=(2, d))
    covariances = np.stack([a @ a.T / d + 0.2 * np.eye(d), np.eye(d)])
    return to_natural(means, covariances)


BOXES = {
    1: Box(np.array([-0.5]), np.array([INF])),
    2: Box(np.array([-0.5, -1.0]), np.array([INF, 2.0])),
    3: Box(np.array([-0.3, -INF, -1.0]), np.array([1.5, INF, INF])),
    4: Box(np.array([-0.3, -INF, -1.0, -2.0]), np.array([1.5, INF, INF, 0.5])),
}
# Beyond three variables the nodes are quasi-random: the derivatives agree as far as they do.
TOLERANCES = {1: 1e-6, 2: 1e-6, 3: 2e-6, 4: 3e-2}


@pytest.mark.parametrize("d", [1, 2, 3, 4])
def test_moments_are_the_derivatives_of_the_log_partition(d):
    theta, box, step = a_component(d), BOXES[d], 1e-4
    at = components_at(theta, box)
    assert sound(at).all()
    for q in range(theta.shape[1]):
        shift = np.zeros_like(theta)
        shift[:, q] = step
        up, down = components_at(theta + shift, box), components_at(theta - shift, box)
        slope = (up.log_partition - down.log_partition) / (2 * step)
        np.testing.assert_allclose(at.expected[:, q], slope, rtol=TOLERANCES[d], atol=TOLERANCES[d])
        slope = (up.expected - down.expected) / (2 * step)
        size = np.abs(at.information).max()
        np.testing.assert_allclose(at.information[:, q], slope, atol=TOLERANCES[d] * size)
        slope = (up.prior_expected - down.prior_expected) / (2 * step)
        np.testing.assert_allclose(at.prior_information[:, q], slope, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("d", [1, 3, 5])
def test_without_a_box_there_is_no_truncation(d):
    at = components_at(a_component(d), Box(np.full(d, -INF), np.full(d, INF)))
    np.testing.assert_array_equal(at.log_partition, at.prior_log_partition)
    np.testing.assert_array_equal(at.information, at.prior_information)


def test_information_is_positive_definite_in_a_corner():
    theta = to_natural(np.array([[-20.0, -30.0, 0.0]]), np.diag([4.0, 9.0, 1.0])[None])
    at = components_at(theta, Box(np.zeros(3), np.array([INF, INF, 2.0])))
    size = np.sqrt(np.diagonal(at.information[0]))
    assert np.linalg.eigvalsh(at.information[0] / np.outer(size, size))[0] > 1e-9


def test_usable_refuses_what_arithmetic_cannot_hold():
    good = a_component(2)
    indefinite, nan = good.copy(), good.copy()
    indefinite[0, 2] = -1.0
    nan[1, 0] = np.nan
    assert usable(good, 2).tolist() == [True, True]
    assert usable(indefinite, 2).tolist() == [False, True]
    assert usable(nan, 2).tolist() == [True, False]
