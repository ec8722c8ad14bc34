"""What is undecided, and which runs would decide most of it."""

import numpy as np
import pytest
from scipy.stats import norm

from crashrate.crash_set.order import RiskOrder
from crashrate.estimation import gap as gaps
from crashrate.estimation.exploration import inflated
from crashrate.estimation.gap import Candidates, Gap, Look, aim_at_gap, candidates, closest, look
from crashrate.estimation.labels import Labels
from crashrate.estimation.strategy import Problem
from crashrate.sampling.pool import draw_pool
from crashrate.traffic.model import TrafficModel


@pytest.fixture
def traffic():
    return TrafficModel([1.0], [[0.0, 0.0]], [np.eye(2)], [-np.inf, -1.0], [np.inf] * 2, ("a", "b"))


@pytest.fixture
def labels(traffic):
    order = RiskOrder.from_mapping({"a": "increasing", "b": "decreasing"}, traffic.names)
    empty = Labels.empty(Problem(traffic=traffic, order=order))
    return empty.add(np.array([[2.0, -0.5], [0.0, -0.8]]), np.array([1.0, 0.0]))


@pytest.fixture
def gap(traffic, labels):
    rng = np.random.default_rng(1)
    proposal = inflated(traffic, (1.0, 4.0))
    return Gap.of(draw_pool(proposal, traffic, labels.coordinates, 20_000, rng), labels)


def half(u):
    return np.full(len(u), 0.5)


def test_masses_are_probabilities_of_what_is_implied(gap):
    in_box = norm.sf(-1.0)
    inner = norm.sf(2.0) * (norm.cdf(-0.5) - norm.cdf(-1.0)) / in_box
    outer = 1 - norm.cdf(0.0) * norm.sf(-0.8) / in_box
    assert gap.inner == pytest.approx(inner, rel=0.1)
    assert gap.outer == pytest.approx(outer, rel=0.05)
    low, high = gap.bounds()
    assert 0 < low < inner < outer < high <= 1


def test_what_is_looked_at_is_undecided(gap):
    seen = look(gap, half, np.random.default_rng(0))
    assert np.isin(np.concatenate([seen.even, seen.heavy]), gap.undecided).all()
    assert len(np.unique(seen.even)) == len(seen.even)


def test_candidates_reach_the_bound_and_are_undecided(gap, traffic, labels):
    rng = np.random.default_rng(0)
    seen = look(gap, half, rng)
    got = candidates(gap, seen, traffic, labels, held=half, rng=rng)
    crash, safe = labels.implied(got.u)
    assert not (crash | safe).any()
    assert (got.x[:, 1] == -1.0).sum() > 50
    assert np.array_equal(labels.coordinates(got.x), got.u)


def test_situations_without_finite_coordinates_are_no_candidates(gap, traffic):
    def singular(x):
        with np.errstate(divide="ignore"):
            return 1 / (x[:, 1] + 1.0)  # infinite on the bound

    order = RiskOrder.from_mapping({"a": "increasing", "c": (singular, "increasing")}, ("a", "b"))
    odd = Labels.empty(Problem(traffic=traffic, order=order))
    rng = np.random.default_rng(0)
    seen = look(gap, half, rng)
    got = candidates(gap, seen, traffic, odd, held=half, rng=rng)
    assert np.isfinite(got.u).all()


def brute(gap, u, h):
    """Gain of one candidate, over all undecided draws."""
    w, v = gap.weights[gap.undecided], gap.pool.u[gap.undecided]
    up, down = w[(v >= u).all(axis=1)].sum(), w[(v < u).all(axis=1)].sum()
    return h * np.log1p(up / gap.inner) - (1 - h) * np.log1p(-down / gap.outer)


def test_the_first_choice_has_the_greatest_gain(gap):
    rng = np.random.default_rng(3)
    rows = rng.choice(gap.undecided, 60, replace=False)
    among = Candidates(gap.pool.x[rows], gap.pool.u[rows], rng.uniform(0.01, 0.99, 60))
    gains = [brute(gap, u, h) for u, h in zip(among.u, among.h, strict=True)]
    got = closest(gap, among, 1, np.random.default_rng(0))
    chosen = int(np.flatnonzero((among.x == got[0]).all(axis=1))[0])
    assert gains[chosen] > 0.95 * max(gains)  # counted by some of the draws


def test_choices_differ_and_are_as_many_as_there_are(gap):
    rng = np.random.default_rng(3)
    rows = rng.choice(gap.undecided, 5, replace=False)
    among = Candidates(gap.pool.x[rows], gap.pool.u[rows], np.full(5, 0.5))
    got = closest(gap, among, 10, rng)
    assert len(np.unique(got, axis=0)) == len(got) == 5
    assert len(closest(gap, among.where(np.zeros(5, bool)), 10, rng)) == 0


def test_the_next_pool_is_drawn_where_it_is_undecided(gap, traffic, labels):
    rng = np.random.default_rng(0)
    seen = look(gap, half, rng)
    proposal = aim_at_gap(gap, seen, traffic, rng)
    again = Gap.of(draw_pool(proposal, traffic, labels.coordinates, 20_000, rng), labels)
    assert len(again.undecided) > len(gap.undecided)


def test_doubt_is_a_distribution_that_peaks_at_one_half():
    seen = Look(np.arange(3), np.arange(1), np.array([0.01, 0.5, 0.99]), np.array([0.5]))
    assert seen.doubt.sum() == pytest.approx(1)
    assert seen.doubt.argmax() == 1


def test_a_run_that_decides_all_has_a_finite_gain():
    """In single precision 1 - 1e-9 is 1."""
    h, all_of_it = np.array([0.0, 0.5, 1.0], np.float32), np.full(3, 0.1, np.float32)
    gain = gaps._gain(h, all_of_it, all_of_it, 0.0, 0.1)
    assert np.isfinite(gain).all()
