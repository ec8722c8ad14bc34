"""Plain Gaussian mixtures: density, draws, fit."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from crashrate.sampling.gaussians import Gaussians, fit_gaussians

MIXTURE = Gaussians(
    np.array([0.3, 0.7]),
    np.array([[-2.0, 0.5], [2.0, -1.0]]),
    np.array([[[0.5, 0.2], [0.2, 0.4]], [[1.0, -0.3], [-0.3, 0.6]]]),
)


def mass(density, half=9.0, n=400):
    """Integral over a square by the midpoint rule."""
    ticks = (np.arange(n) + 0.5) * 2 * half / n - half
    x = np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)
    return np.exp(density(x)).sum() * (2 * half / n) ** 2


def test_density_integrates_to_one():
    assert mass(MIXTURE.log_density) == pytest.approx(1, abs=1e-6)


def test_density_is_that_of_its_components_narrow_ones_too():
    narrow = Gaussians(
        np.array([0.5, 0.5]),
        np.array([[1e3, 0.0], [1e3 + 1.0, 5.0]]),
        np.array([np.diag([1e-6, 1.0]), np.diag([1.0, 1e-4])]),
    )
    for mixture in (MIXTURE, narrow):
        x = mixture.sample(50, np.random.default_rng(0))
        laws = zip(mixture.weights, mixture.means, mixture.covariances, strict=True)
        parts = np.array([w * multivariate_normal(m, c).pdf(x) for w, m, c in laws]).T
        assert np.exp(mixture.log_density(x)) == pytest.approx(parts.sum(axis=1), rel=1e-6)
        shares = parts / parts.sum(axis=1, keepdims=True)
        assert mixture.component_probabilities(x) == pytest.approx(shares, abs=1e-6)


def test_draws_have_the_mixture_moments():
    x = MIXTURE.sample(100_000, np.random.default_rng(1))
    mean = MIXTURE.weights @ MIXTURE.means
    spread = MIXTURE.means - mean
    covariance = np.einsum("k,kij->ij", MIXTURE.weights, MIXTURE.covariances)
    covariance += np.einsum("k,ki,kj->ij", MIXTURE.weights, spread, spread)
    assert x.mean(axis=0) == pytest.approx(mean, abs=0.03)
    assert np.cov(x.T) == pytest.approx(covariance, abs=0.05)


def test_fit_recovers_the_mixture_draws_came_from():
    x = MIXTURE.sample(20_000, np.random.default_rng(2))
    got = fit_gaussians(x, 2, np.random.default_rng(3))
    first = np.argsort(got.means[:, 0])
    assert got.weights[first] == pytest.approx(MIXTURE.weights, abs=0.02)
    assert got.means[first] == pytest.approx(MIXTURE.means, abs=0.05)
    assert got.covariances[first] == pytest.approx(MIXTURE.covariances, abs=0.05)


def test_fit_is_a_function_of_the_seed():
    x = MIXTURE.sample(500, np.random.default_rng(4))
    one, same, other = (fit_gaussians(x, 5, np.random.default_rng(s)) for s in (1, 1, 2))
    assert np.array_equal(one.means, same.means)
    assert not np.array_equal(one.means, other.means)


def test_fit_survives_repeated_rows_and_a_constant_column():
    x = np.repeat(np.random.default_rng(5).standard_normal((4, 2)), 50, axis=0)
    x[:, 1] = 7.0
    got = fit_gaussians(x, 6, np.random.default_rng(6))
    assert got.weights.sum() == pytest.approx(1)
    assert np.isfinite(got.log_density(x)).all()
    assert np.linalg.eigvalsh(got.covariances).min() > 0


def test_draws_that_agree_but_for_rounding_have_a_density_that_can_be_computed():
    rng = np.random.default_rng(4)
    x = np.array([3.0, -70.0]) * (1 + 1e-16 * rng.standard_normal((500, 2)))
    fit = fit_gaussians(x, 1, rng)
    found = fit.log_density(fit.sample(4000, rng)).mean()  # its negative is the entropy
    entropy = np.log(2 * np.pi) + 1 + np.linalg.slogdet(fit.covariances[0])[1] / 2
    assert abs(found + entropy) < 0.1


def test_one_dimension():
    x = np.random.default_rng(7).normal(3.0, 2.0, (4000, 1))
    got = fit_gaussians(x, 1, np.random.default_rng(8))
    assert got.means[0, 0] == pytest.approx(3.0, abs=0.1)
    assert got.covariances[0, 0, 0] == pytest.approx(4.0, rel=0.1)
