"""The regression of consequences: finds what there is to find, and says how sure it is."""

import numpy as np
import pytest

from crashrate.crash_set.regression import covariance, regress

LENGTHS = (np.full(2, 0.7), np.full(2, 2.0))


def learned(f, noise=0.0, n=80, seed=0):
    rng = np.random.default_rng(seed)
    u = rng.normal(size=(n, 2))
    values = f(u) + noise * rng.normal(size=n)
    there = rng.normal(size=(2000, 2)) * 0.8
    mean, variance = regress(u, values, LENGTHS).predict(there)
    return mean - f(there), variance


def test_a_plane_is_found():
    error, _ = learned(lambda u: 0.3 + 0.1 * u[:, 0] - 0.05 * u[:, 1])
    assert np.abs(error).max() < 0.005


def test_a_curve_is_found_closer_than_by_a_plane():
    error, variance = learned(lambda u: 1 / (1 + np.exp(-3 * u[:, 0])))
    assert np.sqrt(np.mean(error**2)) < 0.03
    assert np.mean(variance) < 0.01


@pytest.mark.parametrize("seed", range(3))
def test_the_predicted_variance_is_that_of_a_value(seed):
    noise = 0.2
    error, variance = learned(lambda u: 0.1 * u[:, 0], noise=noise, n=200, seed=seed)
    assert np.mean(error**2 + noise**2) == pytest.approx(np.mean(variance), rel=0.25)


def test_a_value_that_is_foretold_without_noise_is_seen_to_be_too_sure():
    noise = 0.2
    error, variance = learned(lambda u: 0.1 * u[:, 0], noise=noise, n=200)
    trusting = variance - noise**2
    assert np.mean(error**2 + noise**2) != pytest.approx(np.mean(trusting), rel=0.25)


def test_equal_values_leave_some_doubt():
    error, variance = learned(lambda u: np.ones(len(u)), n=10)
    assert np.abs(error).max() < 1e-9
    assert variance.min() > 1e-6
    assert variance.max() < 0.1


def test_prediction_is_that_of_the_normal_law():
    rng = np.random.default_rng(3)
    u, values, there = rng.normal(size=(6, 2)), rng.random(6), rng.normal(size=(4, 2))
    fit = regress(u, values, LENGTHS[:1])
    k = covariance(u, u / 0.7, u, u / 0.7) + fit.noise * np.eye(6)
    across = covariance(there, there / 0.7, u, u / 0.7)
    mean = values.mean() + across @ np.linalg.solve(k, values - values.mean())
    prior = np.diag(covariance(there, there / 0.7, there, there / 0.7)) + fit.noise
    left = prior - np.einsum("ij,ij->i", across @ np.linalg.inv(k), across)
    got = fit.predict(there)
    np.testing.assert_allclose(got[0], mean, rtol=1e-9)
    np.testing.assert_allclose(got[1], fit.variance * left, rtol=1e-7)
