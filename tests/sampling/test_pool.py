"""Pools: shares, densities, and weights that estimate probabilities without bias."""

from dataclasses import replace

import numpy as np
import pytest

from crashrate.sampling.gaussians import Gaussians
from crashrate.sampling.pool import Blend, draw_pool
from crashrate.traffic.model import TrafficModel

TRAFFIC = TrafficModel(
    [1.0], [[0.0, 0.5]], [[[1.0, 0.3], [0.3, 0.8]]], [-1.0, -0.5], [np.inf, np.inf], ("a", "b")
)
SHIFTED = Gaussians(np.ones(1), np.array([[0.8, 0.8]]), 1.5 * np.eye(2)[None])
BLEND = Blend((0.75, 0.25), (SHIFTED, TRAFFIC))
LEVEL = np.array([1.5, 1.5])
EXACT = float(TRAFFIC.box_probability(LEVEL, [np.inf, np.inf]))


def pools(n_pools=250, n=603, proposal=BLEND):
    rng = np.random.default_rng(0)
    return [draw_pool(proposal, TRAFFIC, lambda x: 2 * x, n, rng) for _ in range(n_pools)]


def z_score(estimates, exact):
    estimates = np.array(estimates)
    return (estimates.mean() - exact) / (estimates.std(ddof=1) / np.sqrt(len(estimates)))


def mass(pool):
    return float(pool.weights[(pool.x >= LEVEL).all(axis=1)].sum())


def test_blend_density_is_the_sum_of_shares():
    x = TRAFFIC.sample(20, 1)
    expected = 0.75 * np.exp(SHIFTED.log_density(x)) + 0.25 * np.exp(TRAFFIC.log_density(x))
    assert np.exp(BLEND.log_density(x)) == pytest.approx(expected)


def test_what_is_known_is_not_evaluated_again():
    x = TRAFFIC.sample(20, 1)
    known = TRAFFIC.log_density(x)
    assert BLEND.log_density(x, (TRAFFIC, known)) == pytest.approx(BLEND.log_density(x))
    other = BLEND.log_density(x, (TRAFFIC, known + 1))
    assert not np.allclose(other, BLEND.log_density(x))


def test_blend_gives_each_density_its_share():
    apart = [
        Gaussians(np.ones(1), np.full((1, 1), m), np.full((1, 1, 1), 1e-6)) for m in (0, 9, 18)
    ]
    blend = Blend((0.5, 0.3, 0.2), tuple(apart))
    rng = np.random.default_rng(2)
    counts = np.array(
        [np.bincount((blend.sample(11, rng)[:, 0] / 9).round().astype(int)) for _ in range(2000)]
    )
    assert np.all(counts.sum(axis=1) == 11)
    assert counts.min(axis=0).tolist() == [5, 3, 2]
    assert counts.max(axis=0).tolist() == [6, 4, 3]
    assert counts.mean(axis=0) == pytest.approx([5.5, 3.3, 2.2], abs=0.05)


def test_pool_keeps_what_is_inside_the_box():
    pool = pools(1, n=500)[0]
    assert pool.n_drawn == 500 > len(pool.x)
    assert np.all((pool.x >= TRAFFIC.lower) & (pool.x <= TRAFFIC.upper))
    assert np.array_equal(pool.u, 2 * pool.x)
    assert pool.weights == pytest.approx(np.exp(pool.log_f - pool.log_q) / 500)


def test_weights_estimate_probabilities_without_bias():
    drawn = pools()
    assert abs(z_score([mass(p) for p in drawn], EXACT)) < 4
    assert abs(z_score([p.weights.sum() for p in drawn], 1.0)) < 4


def test_bias_is_seen_where_the_box_is_forgotten():
    forgetful = [replace(p, n_drawn=len(p.x)) for p in pools()]
    assert abs(z_score([mass(p) for p in forgetful], EXACT)) > 8


def test_bias_is_seen_where_a_share_is_forgotten():
    forgetful = [replace(p, log_q=SHIFTED.log_density(p.x)) for p in pools()]
    assert abs(z_score([mass(p) for p in forgetful], EXACT)) > 8


def test_a_share_of_traffic_bounds_the_weights():
    assert max(p.weights.max() * p.n_drawn for p in pools(50)) <= 4.0
