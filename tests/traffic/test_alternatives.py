"""Laws for comparison: densities that integrate, draws that follow them, what they can do."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from crashrate.traffic.alternatives import COPULA, INDEPENDENT, alternatives
from crashrate.traffic.margins import Margin

LOWER, UPPER = np.array([-1.5, -np.inf]), np.array([np.inf, np.inf])
CORRELATION = 0.6


@pytest.fixture(scope="module")
def events():
    cov = [[1.0, CORRELATION], [CORRELATION, 1.0]]
    z = multivariate_normal.rvs([0, 0], cov, 30_000, random_state=np.random.default_rng(0))
    return z[z[:, 0] > -1.5]


@pytest.fixture(scope="module")
def laws(events):
    return {law.name: law for law in alternatives(events, LOWER, UPPER)}


@pytest.mark.parametrize("name", [INDEPENDENT, COPULA])
def test_density_integrates_to_one(laws, name):
    a, b = np.linspace(-1.5, 8, 700), np.linspace(-8, 8, 900)
    grid = np.stack(np.meshgrid(a, b, indexing="ij"), axis=-1).reshape(-1, 2)
    density = np.exp(laws[name].log_density(grid)).reshape(700, 900)
    assert np.trapezoid(np.trapezoid(density, b, axis=1), a) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("name", [INDEPENDENT, COPULA])
def test_draws_follow_the_density(laws, name):
    law = laws[name]
    z = law.sample(100_000, np.random.default_rng(1))
    assert law.contains(z).all()
    uniform = multivariate_normal([0.5, 0.5], 0.2 * np.eye(2))
    ratio = np.exp(uniform.logpdf(z) - law.log_density(z))  # mean 1: the integral of the normal
    assert ratio.mean() == pytest.approx(1.0, abs=4 * ratio.std() / np.sqrt(len(z)))
    far = z[:, 0] > 3.0
    assert far.mean() == pytest.approx(float(law.margins[0].tail.above(np.array([3.0]))[0])
                                       if law.margins[0].tail else far.mean(), rel=0.2)  # fmt: skip


def test_copula_knows_the_correlation_and_the_margins(laws):
    copula = laws[COPULA]
    assert copula.correlation[0, 1] == pytest.approx(CORRELATION, abs=0.1)  # a is truncated
    tail = copula.margins[1].tail
    exact = norm.sf(3.0) * norm.cdf((1.5 + CORRELATION * 3.2) / 0.8) / norm.cdf(1.5)
    assert float(tail.above(np.array([3.0]))[0]) == pytest.approx(exact, rel=0.35)


def test_independent_margins_do_not(laws, events):
    free = laws[INDEPENDENT]
    assert free.independent
    z = free.sample(50_000, np.random.default_rng(2))
    assert abs(np.corrcoef(z.T)[0, 1]) < 0.02
    assert free.log_density(events).sum() < laws[COPULA].log_density(events).sum() - 1000


def test_a_bounded_variable_has_no_pareto_tail(events):
    bounded = alternatives(events[events[:, 1] < 2], LOWER, np.array([np.inf, 2.0]))[1]
    assert [m.tail is None for m in bounded.margins] == [False, True]


@pytest.fixture(scope="module")
def skewed():
    """The margin of values one in a thousand of which lies far beyond the deviation of all."""
    rng = np.random.default_rng(3)
    z = np.abs(np.where(rng.random(20_000) < 1e-3, 40.0, 1.0) * rng.standard_normal(20_000))
    return Margin.of(z, 0.0, np.inf)


def test_scores_and_values_are_each_others_inverse_to_the_end(skewed):
    z = np.array([1e-4, 0.3, 2.0, 5.0, 20.0, 60.0, 120.0])
    assert skewed.of_scores(skewed.normal_scores(z)) == pytest.approx(z, rel=1e-4, abs=1e-9)


def test_a_rare_wide_component_is_drawn(skewed):
    assert skewed.body.covariance[0, 0] < 2.0**2
    z = skewed.of_scores(np.random.default_rng(4).standard_normal(1_000_000))
    for level in (20.0, 40.0):
        expected = 1e6 * (1 - skewed.below(np.array([level]))[0])
        assert expected > 50
        assert np.count_nonzero(z > level) == pytest.approx(expected, abs=5 * np.sqrt(expected))
