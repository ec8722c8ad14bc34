"""What is hardly ever met is left out of a round's variance, and stays in its estimate."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from crashrate.estimation.hindsight import design, reconsider
from crashrate.estimation.rounds import combine, measure
from crashrate.estimation.selection import to_estimate
from crashrate.estimation.view import View
from crashrate.sampling.gaussians import Gaussians
from crashrate.sampling.pool import draw_pool

SHARE = 0.005


def edge(t):
    """The probability of a crash along the first coordinate."""
    found = 1 / (1 + np.exp(-12 * (t - 2.5)))
    return np.where(found > 1e-3, found, 0.0)


EDGE = quad(lambda t: norm.pdf(t) * edge(t), 1.9, 9.0)[0]


@pytest.fixture
def tailed(cases):
    """A pool with an edge, and `share` as many crashes in all of traffic on its safe side."""

    def make(rng, share=SHARE, n=4000):
        proposal = Gaussians(np.ones(1), np.zeros((1, 2)), 4 * np.eye(2)[None])
        pool = draw_pool(proposal, cases.standard_normal(2), lambda x: x, n, rng)
        near = edge(pool.u[:, 0])
        odds = share * EDGE / norm.cdf(pool.u[near == 0, 0].max())
        h, none = np.where(near == 0, odds, near), np.zeros(n, dtype=bool)
        return View(pool, h, h, none, none, none, none, none, ordered=True)

    return make


def round_of(view, outcomes, n, rng):
    drawn = to_estimate(view, n, rng)
    return replace(measure(view, drawn, outcomes[drawn.rows]), design=design(view, drawn))


def test_negligible_is_what_is_least_likely_up_to_the_share(tailed):
    view = replace(tailed(np.random.default_rng(0)), neglected=SHARE)
    mass = view.weights * view.h
    assert view.negligible.any()
    assert mass[view.negligible].sum() <= SHARE * mass.sum()
    assert view.h[view.negligible].max() <= view.h[~view.negligible].min()
    assert not replace(view, neglected=0.0).negligible[mass > 0].any()


def test_it_is_left_out_of_the_variance_and_of_nothing_else(tailed):
    rng = np.random.default_rng(1)
    whole = tailed(rng)
    view = replace(whole, neglected=0.01)
    outcomes = (rng.random(len(view.h)) < view.h).astype(float)
    drawn = to_estimate(view, 10, np.random.default_rng(2))
    same = to_estimate(whole, 10, np.random.default_rng(2))
    assert np.array_equal(drawn.rows, same.rows)
    one, all_of_it = (measure(v, drawn, outcomes[drawn.rows]) for v in (view, whole))
    assert one.variance < 0.8 * all_of_it.variance
    assert replace(one, variance=0.0, squares=0.0) == replace(all_of_it, variance=0.0, squares=0.0)
    assert one.squares == all_of_it.squares


def campaigns(tailed, share, times=200):
    """Intervals of ten rounds whose h is right, crashes on the safe side left out of variances."""
    rng, found = np.random.default_rng(3), []
    for _ in range(times):
        rounds = []
        for _ in range(10):
            view = replace(tailed(rng, share, n=1000), neglected=share / (1 + share))
            outcomes = (rng.random(len(view.h)) < view.h).astype(float)
            rounds.append(round_of(view, outcomes, 12, rng))
        found.append(combine(rounds, 0.95))
    return [(c.lower, c.upper) for c in found]


def test_intervals_hold_though_the_rarest_crashes_are_left_out(tailed, check_coverage):
    check_coverage(campaigns(tailed, SHARE), (1 + SHARE) * EDGE)


def test_intervals_that_leave_out_a_third_are_seen_to_fail(tailed, check_coverage):
    with pytest.raises(AssertionError, match="intervals hold"):
        check_coverage(campaigns(tailed, 0.5, times=50), 1.5 * EDGE)


def test_a_round_answers_for_it_once_more_is_held_of_it(tailed):
    rng = np.random.default_rng(4)
    whole = tailed(rng)
    view = replace(whole, neglected=0.01)
    outcomes = (rng.random(len(view.h)) < view.h).astype(float)
    one, all_of_it = (round_of(v, outcomes, 10, np.random.default_rng(5)) for v in (view, whole))

    def known(times):
        """By a surrogate that holds so many times as much of the safe side."""

        def hold(u):
            near = edge(u[:, 0])
            return np.where(near == 0, times * view.h.min(), near)

        return [r.variance for r in reconsider([one, all_of_it], hold)]

    assert known(1)[0] == pytest.approx(one.variance, rel=1e-3)
    grown = known(50)
    assert grown[0] > 3 * one.variance
    assert grown[1] - grown[0] == pytest.approx(all_of_it.variance - one.variance, rel=0.3)
