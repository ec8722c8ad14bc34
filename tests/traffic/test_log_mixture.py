"""Log densities of Gaussian mixtures: against exact rational arithmetic, by both kernels."""

import math
import pickle
import sys
from dataclasses import replace
from fractions import Fraction
from importlib.util import find_spec

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from crashrate.errors import MissingExtraError
from crashrate.traffic import compiled
from crashrate.traffic.log_mixture import LogMixture
from crashrate.traffic.model import TrafficModel

needs_numba = pytest.mark.skipif(find_spec("numba") is None, reason="the extra is not installed")
KERNELS = [False, pytest.param(True, marks=needs_numba)]


def exact_log_normal(x, mean, covariance):
    """log N(x; mean, covariance) of one row, rounded once at the end of each part."""
    d = len(x)
    table = [
        [*map(Fraction, row), Fraction(a) - Fraction(b)]
        for row, a, b in zip(covariance.tolist(), x.tolist(), mean.tolist(), strict=True)
    ]
    square, determinant = Fraction(0), Fraction(1)
    for k in range(d):  # Gauss: square = Σ (row k's right side)² / pivot k
        pivot = table[k][k]
        determinant *= pivot
        square += table[k][d] ** 2 / pivot
        for i in range(k + 1, d):
            factor = table[i][k] / pivot
            table[i] = [a - factor * b for a, b in zip(table[i], table[k], strict=True)]
    return -0.5 * (float(square) + math.log(determinant) + d * math.log(2 * math.pi))


def exact_log_terms(x, weights, means, covariances):
    laws = list(zip(weights, means, covariances, strict=True))
    return np.array([[math.log(w) + exact_log_normal(r, m, c) for w, m, c in laws] for r in x])


def of(weights, means, covariances, shift=None, scale=None):
    means = np.asarray(means, float)
    covariances = np.asarray(covariances, float)
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    shift = weights @ means if shift is None else shift
    scale = np.sqrt(weights @ variances) if scale is None else scale
    none = np.zeros(len(weights))
    return LogMixture.of(weights, none, means, covariances, shift=shift, scale=scale)


def random_mixture(n_components, d, condition, rng):
    """Weights, means and covariances with the given condition number in random directions."""
    turn = np.linalg.qr(rng.standard_normal((n_components, d, d)))[0]
    eigenvalues = np.geomspace(1.0, 1.0 / condition, d)
    covariances = np.einsum("kij,j,klj->kil", turn, eigenvalues, turn)
    covariances = 0.5 * (covariances + covariances.transpose(0, 2, 1))
    return rng.dirichlet(np.ones(n_components)), rng.normal(size=(n_components, d)), covariances


def rows_at(sigmas, n, means, covariances, rng):
    """Rows `sigmas` standard deviations from the mean of one component, in all directions."""
    k = rng.integers(len(means), size=n)
    u = rng.standard_normal((n, means.shape[1]))
    u *= sigmas / np.linalg.norm(u, axis=1, keepdims=True)
    return means[k] + np.einsum("nij,nj->ni", np.linalg.cholesky(covariances)[k], u)


@pytest.mark.parametrize("fast", KERNELS)
@pytest.mark.parametrize("sigmas", [1.0, 5.0, 30.0])
@pytest.mark.parametrize("condition", [1.0, 1e3, 1e6])
@pytest.mark.parametrize(("n_components", "d"), [(1, 1), (9, 2), (12, 3), (40, 3), (5, 6)])
def test_log_density_is_exact_thirty_sigma_out_and_where_components_are_thin(
    n_components, d, condition, sigmas, fast
):
    rng = np.random.default_rng([n_components, d, int(condition), int(sigmas)])
    law = random_mixture(n_components, d, condition, rng)
    x = rows_at(sigmas, 40, law[1], law[2], rng)
    exact = logsumexp(exact_log_terms(x, *law), axis=1)
    got = of(*law).log_density(x, fast=fast)
    # what a relative change of 1e-16 in the covariance does
    np.testing.assert_allclose(got, exact, rtol=1e-10, atol=1e-10 if condition > 1e3 else 1e-11)


def test_expanded_squares_alone_would_lose_what_thin_components_need():
    """The negative control: without the roots the same rows are wrong by far more."""
    rng = np.random.default_rng(0)
    law = random_mixture(40, 3, 1e6, rng)
    x = rows_at(1.0, 40, law[1], law[2], rng)
    exact = logsumexp(exact_log_terms(x, *law), axis=1)
    mixture = of(*law)
    assert len(mixture.stiff) == 40
    expanded = replace(mixture, stiff=np.empty(0, np.int64)).log_density(x)
    assert np.abs(mixture.log_density(x) - exact).max() < 1e-10
    assert np.abs(expanded - exact).max() > 5e-10


def test_both_ways_to_a_square_agree_where_neither_cancels():
    rng = np.random.default_rng(1)
    law = random_mixture(9, 3, 10.0, rng)
    x = rows_at(2.0, 200, law[1], law[2], rng)
    mixture = of(*law)
    assert not len(mixture.stiff)
    by_roots = replace(mixture, stiff=np.arange(0, 9, 2))
    np.testing.assert_allclose(by_roots.log_terms(x), mixture.log_terms(x), rtol=1e-13, atol=1e-12)


@pytest.mark.parametrize("fast", KERNELS)
def test_rows_so_far_out_that_every_term_underflows(fast):
    law = random_mixture(3, 2, 10.0, np.random.default_rng(2))
    near = rows_at(1.0, 300, law[1], law[2], np.random.default_rng(3))
    x = np.concatenate([near, 1e3 * near, 1e8 * near])
    exact = logsumexp(exact_log_terms(x[::30], *law), axis=1)
    got = of(*law).log_density(x, fast=fast)
    np.testing.assert_allclose(got[::30], exact, rtol=1e-12)
    assert exact.min() < -1e15


@pytest.mark.parametrize("fast", KERNELS)
@pytest.mark.parametrize("n", [0, 1, 7, 255, 256, 257, 4096, 20_001])
def test_a_row_does_not_care_how_many_others_there_are(n, fast):
    rng = np.random.default_rng(4)
    law = random_mixture(9, 3, 30.0, rng)
    x = rows_at(3.0, n, law[1], law[2], rng)
    x[::100] *= 50.0  # far ones among them
    got = of(*law).log_density(x, fast=fast)
    assert got.shape == (n,)
    some = np.arange(0, n, max(1, n // 50))
    laws = zip(*law, strict=True)
    terms = [np.log(w) + multivariate_normal(m, c).logpdf(x[some]) for w, m, c in laws]
    if n:
        direct = np.logaddexp.reduce(np.reshape(terms, (9, -1)), axis=0)
        np.testing.assert_allclose(got[some], direct, rtol=1e-10)


def test_shares_and_blocks_are_those_of_the_terms_far_rows_too():
    rng = np.random.default_rng(5)
    law = random_mixture(12, 3, 100.0, rng)
    x = rows_at(3.0, 9000, law[1], law[2], rng)
    x[::7] *= 40.0
    mixture = of(*law)
    terms = mixture.log_terms(x)
    log_density = logsumexp(terms, axis=1)
    assert log_density.min() < -1000.0
    np.testing.assert_allclose(mixture.log_density(x), log_density, rtol=1e-12)
    shares = mixture.shares(x)
    np.testing.assert_allclose(shares, np.exp(terms - log_density[:, None]), atol=1e-9)
    np.testing.assert_allclose(shares.sum(axis=1), 1.0, rtol=1e-13)
    for block in mixture.blocks(x):
        np.testing.assert_allclose(block.logs, log_density[block.rows], rtol=1e-12)
        np.testing.assert_allclose(block.powers.sum(axis=0), block.totals, rtol=1e-13)


@pytest.mark.parametrize("fast", KERNELS)
def test_units_and_weights_of_nothing_change_nothing(fast):
    rng = np.random.default_rng(6)
    weights, means, covariances = random_mixture(4, 3, 100.0, rng)
    x = rows_at(2.0, 100, means, covariances, rng)
    unit = np.array([1e-9, 1.0, 1e9])
    scaled = of(weights, means * unit, covariances * np.outer(unit, unit))
    plain = of(weights, means, covariances).log_density(x, fast=fast)
    np.testing.assert_allclose(scaled.log_density(x * unit, fast=fast), plain, rtol=1e-12)
    more = of(
        np.append(weights, 0.0),
        np.vstack([means, x[:1]]),
        np.append(covariances, covariances[:1], 0),
    )
    np.testing.assert_allclose(more.log_density(x, fast=fast), plain, rtol=1e-13)
    assert more.shares(x)[:, -1].max() < 1e-290


@needs_numba
@pytest.mark.parametrize("d", [1, 2, 3, 6])
def test_the_compiled_kernel_agrees_with_the_other(d):
    rng = np.random.default_rng(7)
    law = random_mixture(11, d, 1e4, rng)
    x = np.concatenate([rows_at(s, 2000, law[1], law[2], rng) for s in (1.0, 4.0, 12.0)])
    mixture = of(*law)
    np.testing.assert_allclose(
        mixture.log_density(x, fast=True), mixture.log_density(x), rtol=1e-12, atol=1e-12
    )
    columns = np.asfortranarray(x)
    assert np.array_equal(
        mixture.log_density(columns, fast=True), mixture.log_density(x, fast=True)
    )


@needs_numba
def test_a_traffic_model_offers_the_compiled_kernel():
    model = TrafficModel(
        [0.3, 0.7], [[0.0], [2.0]], [[[1.0]], [[0.5]]], [0.0], [4.0], ["gap"], scales=["log"]
    )
    x = np.array([[-1.0], [0.0], [0.5], [4.0], [5.0]])
    np.testing.assert_allclose(model.log_density(x, fast=True), model.log_density(x), rtol=1e-12)


def test_without_the_extra_the_message_says_what_to_do(monkeypatch):
    monkeypatch.setitem(sys.modules, "numba", None)
    compiled.compiled_totals.cache_clear()
    mixture = of(np.array([1.0]), [[0.0]], [[[1.0]]])
    with pytest.raises(MissingExtraError, match=r"crashrate\[fast\]"):
        mixture.log_density(np.zeros((3, 1)), fast=True)


def test_a_mixture_can_be_pickled():
    mixture = of(np.array([1.0]), [[0.0]], [[[1.0]]])
    x = np.ones((3, 1))
    assert np.array_equal(
        pickle.loads(pickle.dumps(mixture)).log_density(x),  # noqa: S301
        mixture.log_density(x),
    )
