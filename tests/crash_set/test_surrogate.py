"""The probit Gaussian process against quadrature, and what the campaign relies on."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import log_ndtr, ndtr

from crashrate.crash_set.surrogate import Prior, fit_surrogate

PRIOR = Prior(bump=0.5, length=1.2, variance=2.0, linear=0.7, slope=0.4, constant=-0.2)
SHARP = Prior(bump=0.5, length=2.0, variance=1e4, linear=1.0, slope=1.0, constant=0.0)
NODES, MASSES = np.polynomial.hermite_e.hermegauss(60)


def posterior(u, crash, at, prior=PRIOR):
    """Mean of the latent danger and P(crash) at one point, by tensor Gauss-Hermite quadrature."""
    covariance, mean = prior.covariance(u, u), prior.mean(u)
    root = np.linalg.cholesky(covariance)
    z = np.stack(np.meshgrid(*[NODES] * len(u), indexing="ij"), axis=-1).reshape(-1, len(u))
    masses = np.array(np.meshgrid(*[MASSES] * len(u), indexing="ij")).prod(axis=0).ravel()
    latent = mean + z @ root.T
    likelihood = ndtr(np.where(crash, 1.0, -1.0) * latent).prod(axis=1) * masses
    likelihood /= likelihood.sum()
    k = prior.covariance(at, u)[0]
    weights = np.linalg.solve(covariance, k)
    given = prior.mean(at)[0] + (latent - mean) @ weights
    variance = prior.variances(at)[0] - weights @ k
    return likelihood @ given, likelihood @ ndtr(given / math.sqrt(1 + variance))


ONE = (np.array([[0.3, -0.5]]), np.array([True]))
TWO = (np.array([[0.3, -0.5], [-0.8, 0.9]]), np.array([True, False]))
POINTS = [np.array([p]) for p in ([0.3, -0.5], [1.5, 1.0], [-1.0, -0.2])]


@pytest.mark.parametrize("at", POINTS)
@pytest.mark.parametrize(("labels", "tolerance"), [(ONE, 4e-3), (TWO, 0.01)])
def test_posterior_equals_quadrature(labels, tolerance, at):
    u, crash = labels
    mean, probability = posterior(u, crash, at)
    got = fit_surrogate(u, crash, PRIOR).predict(at)
    assert got.danger[0] * math.sqrt(PRIOR.variance) == pytest.approx(mean, abs=tolerance)
    assert got.probability[0] == pytest.approx(probability, abs=0.01)


def test_quadrature_tells_the_posterior_from_the_prior():
    u, crash = TWO
    prior = ndtr(PRIOR.mean(u) / np.sqrt(1 + PRIOR.variances(u)))
    exact = [posterior(u, crash, row[None])[1] for row in u]
    assert np.all(np.abs(exact - prior) > 0.05)


def test_leave_one_out_score_of_one_label_is_the_prior_probability():
    u, crash = ONE
    z = PRIOR.mean(u) / np.sqrt(1 + PRIOR.variances(u))
    assert fit_surrogate(u, crash, PRIOR).log_score == pytest.approx(log_ndtr(z)[0], abs=1e-6)


def test_leave_one_out_score_equals_refitting():
    rng = np.random.default_rng(1)
    u = rng.standard_normal((12, 2))
    crash = u.sum(axis=1) + 0.5 * rng.standard_normal(12) > 0
    score = 0.0
    for i in range(12):
        rest = np.arange(12) != i
        p = fit_surrogate(u[rest], crash[rest], PRIOR).predict(u[i : i + 1]).probability[0]
        score += math.log(p if crash[i] else 1 - p)
    assert fit_surrogate(u, crash, PRIOR).log_score == pytest.approx(score, abs=0.2)


def sharp_labels(n, seed=0):
    u = np.random.default_rng(seed).standard_normal((n, 2))
    return u, u.sum(axis=1) > 0.3


def test_sharp_labels_are_reproduced():
    u, crash = sharp_labels(40)
    got = fit_surrogate(u, crash, SHARP)
    far = np.random.default_rng(1).uniform(-50, 50, (500, 2))
    p = got.predict(np.vstack([u, far])).probability
    assert np.all((p >= 0) & (p <= 1))
    assert np.array_equal(p[:40] > 0.5, crash)
    assert np.mean((p[40:] > 0.5) == (far.sum(axis=1) > 0.3)) > 0.9


def test_contradictory_and_repeated_labels_keep_everything_finite():
    u = np.repeat(np.array([[0.0, 0.0], [1.0, 1.0]]), 4, axis=0)
    got = fit_surrogate(u, np.array([True, False] * 4), SHARP)
    assert np.isfinite(got.log_score)
    assert got.predict(np.array([[0.0, 0.0]])).probability[0] == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize("scales", [10.0, 1e3])
@pytest.mark.filterwarnings("error")
def test_a_crash_far_against_the_prior_keeps_everything_finite(scales):
    # steep kernels that are tried and rejected hold such a crash to be safe beyond all doubt
    u = np.array([[-scales, -scales], [0.0, 0.0], [0.5, 0.5], [0.01, 0.0]])
    crash = np.array([True, False, True, False])
    fit = fit_surrogate(u, crash, replace(SHARP, slope=1e3))
    seen = fit.predict(u)
    assert np.isfinite([seen.danger, seen.probability]).all()
    assert fit.log_score < -1e3
    assert ((seen.probability > 0.5) == crash).all()


def test_danger_grows_with_the_prior_slope():
    u = np.array([[1.0, 1.0], [-1.0, -1.0]])
    line = np.linspace(-3, 3, 25)[:, None] * np.ones(2)
    p = fit_surrogate(u, np.array([True, False]), SHARP).predict(line).probability
    assert np.all(np.diff(p) >= 0)
    assert p[0] < 0.05
    assert p[-1] > 0.95


def test_danger_measures_the_distance_to_the_edge():
    u, crash = sharp_labels(80)
    plane = Prior(bump=0.1, length=3.0, variance=1e3, linear=1.0, slope=1.0, constant=0.0)
    at = np.array([[0.15, 0.15], [1.0, -0.7], [1.5, 1.5], [-1.0, -1.0]])
    danger = fit_surrogate(u, crash, plane).predict(at).danger
    assert np.abs(danger[:2]).max() < 0.25
    assert danger[2] > 0.5
    assert danger[3] < -0.5


def test_blocks_do_not_change_predictions():
    u, crash = sharp_labels(20)
    fit, at = fit_surrogate(u, crash, SHARP), sharp_labels(33, seed=2)[0]
    whole, parts = fit.predict(at), fit.predict(at, block=7)
    assert parts.probability == pytest.approx(whole.probability, abs=1e-5)
    assert fit.predict(at[:0]).probability.shape == (0,)


def test_warm_start_ends_where_a_cold_one_does():
    u, crash = sharp_labels(40, seed=3)
    early = fit_surrogate(u[:30], crash[:30], PRIOR)
    warm = fit_surrogate(u, crash, PRIOR, early.sites.grown(len(u)))
    cold = fit_surrogate(u, crash, PRIOR)
    at = sharp_labels(50, seed=4)[0]
    assert warm.predict(at).probability == pytest.approx(cold.predict(at).probability, abs=5e-3)
    assert warm.log_score == pytest.approx(cold.log_score, abs=0.05)
    assert warm.predict(at).probability != pytest.approx(early.predict(at).probability, abs=5e-3)


@pytest.mark.parametrize("wavy", [False, True])
def test_score_prefers_the_kernel_that_labels_came_from(wavy):
    u = np.random.default_rng(5).uniform(-2, 2, (120, 2))
    crash = u[:, 0] + u[:, 1] + (1.5 * np.sin(3 * u[:, 0]) if wavy else 0) > 0
    straight = Prior(bump=0.01, length=3.0, variance=1e3, linear=1.0, slope=1.0, constant=0.0)
    bumpy = Prior(bump=2.0, length=0.7, variance=1e3, linear=1.0, slope=1.0, constant=0.0)
    scores = [fit_surrogate(u, crash, prior).log_score for prior in (straight, bumpy)]
    assert (scores[1] > scores[0]) == wavy


def test_an_additive_bump_is_one_for_each_coordinate():
    prior = replace(PRIOR, linear=0.0, additive=True)
    u = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 9.0]])  # alike in two coordinates of three
    near, far = prior.covariance(u, u)[0]
    assert near == pytest.approx(prior.variance * prior.bump)
    assert far == pytest.approx(2 / 3 * near)
    assert np.diag(prior.covariance(u, u)) == pytest.approx(prior.variances(u))


@pytest.mark.parametrize("additive", [False, True])
def test_score_tells_whether_effects_add_up(additive):
    """Without it the surrogate of a sum in six coordinates took half as many labels more."""
    u = np.random.default_rng(6).normal(size=(250, 6))
    crash = (np.exp(0.6 * u).sum(axis=1) > 9.0) if additive else (u[:, 0] * u[:, 1] > 0.0)
    joint = Prior(bump=0.5, length=2.8, variance=1e3, linear=1.0, slope=1.0, constant=0.0)
    each = replace(joint, bump=3.0, length=2.0, additive=True)
    scores = [fit_surrogate(u, crash, prior).log_score for prior in (joint, each)]
    assert (scores[1] > scores[0]) == additive


def test_prior_moments():
    u = np.array([[0.5, -1.0], [2.0, 0.3]])
    assert np.diag(PRIOR.covariance(u, u)) == pytest.approx(PRIOR.variances(u))
    plane = math.sqrt(2.0) * 0.4 * u.sum(axis=1) / math.sqrt(2)
    assert PRIOR.mean(u) == pytest.approx(plane - 0.2 * np.sqrt(PRIOR.variances(u)))
