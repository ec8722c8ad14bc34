"""Which draws of a pool are simulated."""

from dataclasses import replace

import numpy as np
import pytest

from crashrate.estimation.selection import (
    aside,
    audit,
    greedy,
    mean_squares,
    systematic,
    to_estimate,
    to_learn,
)


@pytest.fixture
def view(toy_view):
    return toy_view(np.random.default_rng(0), n=300)[0]


def test_probabilities_sum_to_one_and_reach_whatever_may_be_wrong(view):
    drawn = to_estimate(view, 6, np.random.default_rng(1))
    assert drawn.probabilities.sum() == pytest.approx(1)
    assert (drawn.n, drawn.rows.shape) == (6, drawn.times.shape)
    assert drawn.probabilities.min() > 0  # every draw here has some weight and some doubt


def test_rows_are_drawn_as_often_as_their_probabilities_say(view):
    rng, n, times = np.random.default_rng(2), 5, 4000
    counts = np.zeros(len(view.h))
    for _ in range(times):
        drawn = to_estimate(view, n, rng)
        counts[drawn.rows] += drawn.times
    expected = n * times * drawn.probabilities
    likely = expected > 20
    z = (counts - expected)[likely] / np.sqrt(expected[likely])
    assert np.abs(z).max() < 4.5
    uniform = np.full(likely.sum(), n * times / len(view.h))  # the check tells other frequencies
    assert np.abs((counts[likely] - uniform) / np.sqrt(uniform)).max() > 4.5


@pytest.mark.parametrize("expected", [0.02, 0.7, 1.0, 1.3, 5.5])
def test_mean_squares_are_those_of_systematic_draws(expected):
    starts = (np.arange(20_000) + 0.5) / 20_000
    n = 20
    likely = np.array([0.7, expected, n - 0.7 - expected]) / n
    times = np.array([(systematic(likely, n, start) == 1).sum() for start in starts])
    got = ((times / expected) ** 2).mean()
    assert mean_squares(np.array([expected]))[0] == pytest.approx(got, rel=1e-3)


def test_a_directed_round_draws_for_other_traffic_and_still_for_its_own(view):
    other = view.under(np.exp(3 * (view.pool.x[:, 0] - view.pool.x[:, 1])))
    own, theirs, mixed = (
        to_estimate(v, 6, np.random.default_rng(1), towards).probabilities
        for v, towards in ((view, None), (other, None), (view, other))
    )
    assert mixed == pytest.approx(0.25 * own + 0.75 * theirs)
    assert np.abs(own - theirs).sum() > 0.5


def test_systematic_draws_spread_over_h(view):
    rng = np.random.default_rng(3)
    spread = [np.ptp(view.h[to_estimate(view, 8, rng).rows]) for _ in range(50)]
    assert min(spread) > 0.4


def test_all_certain_is_drawn_all_the_same(view):
    certain = np.ones(len(view.h), bool)
    sure = replace(
        view, h=certain.astype(float), inner=certain, safe=~certain, surrogate_h=0.999 * certain
    )
    drawn = to_estimate(sure, 4, np.random.default_rng(4))
    assert np.isfinite(drawn.probabilities).all()
    assert drawn.probabilities.sum() == pytest.approx(1)


def test_greedy_rows_are_distinct_and_doubtful(view):
    rows = greedy(view, 10, np.random.default_rng(5))
    assert 2 <= len(rows) <= 10
    assert len(np.unique(rows)) == len(rows)
    assert view.undecided[rows].all()


def test_greedy_prefers_what_settles_most(view):
    first = greedy(view, 1, np.random.default_rng(6))[0]
    u, weights = view.pool.u, view.spread / view.spread.sum()

    def settled(row):
        above = weights[(u >= u[row]).all(axis=1)].sum()
        below = weights[(u <= u[row]).all(axis=1)].sum()
        return view.h[row] * above + (1 - view.h[row]) * below

    others = np.random.default_rng(7).choice(len(u), 50, p=weights)
    assert settled(first) > np.quantile([settled(row) for row in others], 0.8)


def test_greedy_finds_nothing_where_nothing_is_in_doubt(view):
    sure = replace(view, h=np.zeros(len(view.h)))
    assert len(greedy(sure, 5, np.random.default_rng(8))) == 0
    assert len(greedy(view, 0, np.random.default_rng(8))) == 0


@pytest.mark.parametrize("ordered", [True, False])
@pytest.mark.parametrize("n", [1, 2, 10])
def test_learning_draws(view, n, ordered):
    view = replace(view, ordered=ordered)
    rows = to_learn(view, n, np.arange(1), np.random.default_rng(9))
    assert 1 <= len(rows) <= n
    assert np.array_equal(rows, np.unique(rows))


def test_audits_are_drawn_as_traffic_draws_what_is_implied_to_crash(view):
    rng = np.random.default_rng(10)
    rows = np.concatenate([audit(view, 1, rng) for _ in range(3000)])
    assert view.inner[rows].all()
    weights = np.where(view.inner, view.weights, 0.0)
    u = view.pool.u[:, 0]
    mean = float(weights @ u / weights.sum())
    assert u[rows].mean() == pytest.approx(mean, abs=4 * u[rows].std() / np.sqrt(len(rows)))
    assert abs(u[view.inner].mean() - mean) > 8 * u[rows].std() / np.sqrt(len(rows))


def test_nothing_implied_is_nothing_to_audit(view):
    none = replace(view, inner=np.zeros(len(view.h), dtype=bool))
    assert len(audit(none, 5, np.random.default_rng(11))) == 0
    assert len(audit(view, 0, np.random.default_rng(11))) == 0


def test_what_is_put_aside_holds_the_audits_first(view):
    audits = np.flatnonzero(view.inner)[:2]
    rows = aside(view, 4, audits, np.random.default_rng(12))
    assert len(rows) <= 4
    assert np.array_equal(rows[view.inner[rows]], audits)
    assert np.array_equal(aside(view, 1, audits, np.random.default_rng(12)), audits[:1])
