"""Consequences in a round: unbiased whatever was expected of them, and honest together."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from crashrate.estimation.carried import Carried, carry, together
from crashrate.estimation.rounds import Round
from crashrate.estimation.selection import to_estimate
from crashrate.estimation.view import Moments

TIMES = 1500
WRONG = 0.7  # what is expected of every event, where 0.25 on average comes


@pytest.fixture
def seen(toy_view):
    """A view with a wrong h and a wrong g, the outcomes, and consequences left to chance."""
    view, y = toy_view(np.random.default_rng(0))
    risk = 0.5 / (1 + np.exp(-view.pool.x[:, 0]))
    held = Moments(view.h * WRONG, view.h * WRONG)
    return replace(view, consequences=(held,)), y, y * risk


def redrawn(view, y, mean, *, n=6, times=TIMES, trust=False):
    rng, estimates = np.random.default_rng(1), []
    for _ in range(times):
        drawn = to_estimate(view, n, rng)
        z = (rng.random(len(y)) < mean)[drawn.rows].astype(float)  # Bernoulli given x
        got = carry(view, drawn, y[drawn.rows], z[:, None])[0].round
        estimates.append(got.predicted + 1e-6 * rng.random() if trust else got.estimate)
    return np.array(estimates)


@pytest.mark.parametrize("aim", [None, 0])
def test_a_round_is_unbiased_for_wrong_expectations(seen, check_mean, aim):
    view, y, mean = seen
    truth = float(view.weights @ mean)
    assert abs(view.weights @ view.consequences[0].mean / truth - 1) > 1
    check_mean(redrawn(replace(view, aim=aim), y, mean), truth)


def test_trusting_what_was_expected_is_seen_to_be_biased(seen, check_mean):
    view, y, mean = seen
    with pytest.raises(AssertionError, match="z ="):
        check_mean(redrawn(view, y, mean, times=100, trust=True), float(view.weights @ mean))


def test_the_predicted_variance_is_seen_where_the_expectations_are_right(toy_view):
    view, _ = toy_view(np.random.default_rng(2))
    g = 0.2 + 0.6 * np.random.default_rng(3).random(len(view.h))
    held = Moments(view.h * g, view.h * (g * g + g * (1 - g) / 2))
    view = replace(view, consequences=(held,))
    rng, moved = np.random.default_rng(4), []
    for _ in range(2500):
        drawn = to_estimate(view, 6, rng)
        y = rng.random(len(g)) < view.h
        z = y * (g + np.sqrt(g * (1 - g) / 2) * rng.choice([-1, 1], len(g)))
        got = carry(view, drawn, y[drawn.rows].astype(float), z[drawn.rows, None])[0].round
        moved.append(got.estimate - got.predicted)
    part = view.weights * held.mean
    pool = float(part @ part) - part.sum() ** 2 / view.pool.n_drawn
    assert np.var(moved) == pytest.approx(got.variance - pool, rel=0.15)


def test_failed_simulations_bracket_what_they_may_have_been(seen):
    view, y, mean = seen
    drawn = to_estimate(view, 8, np.random.default_rng(5))
    y, z = y[drawn.rows].copy(), (mean[drawn.rows] * 0.9)[:, None]
    y[[1, 5]], z[[1, 5]] = np.nan, np.nan
    got = carry(view, drawn, y, z)[0].round
    ends = [
        carry(view, drawn, np.nan_to_num(y), np.where(np.isnan(z), e, z))[0].round.estimate
        for e in (0.0, 1.0)
    ]
    assert [got.lowest, got.highest] == pytest.approx(ends)
    assert got.lowest < got.estimate < got.highest


def test_an_aim_draws_where_the_consequence_is_in_doubt_and_leaves_every_draw_possible(seen):
    view, _, _ = seen
    deep = view.pool.x[:, 0] > 1
    held = Moments(view.h * deep, view.h * np.where(deep, 1.0, 0.0))
    sharp = Moments(held.mean * 0.5, held.square * 0.5)
    rng = np.random.default_rng(6)
    aimed = to_estimate(replace(view, consequences=(sharp,), aim=0), 6, rng).probabilities
    plain = to_estimate(replace(view, consequences=(sharp,)), 6, rng).probabilities
    assert aimed[deep].sum() > 0.85 > 2 * plain[deep].sum()
    assert np.all(aimed[plain > 0] > 0)


def carried(estimate, deviation, n_runs=10, events=(1e-6, 1e-13), share=0.0):
    found = Round(
        n_runs=n_runs,
        estimate=estimate,
        lowest=estimate,
        highest=estimate,
        predicted=max(estimate, 1e-12),
        known=max(estimate, 1e-12),
        variance=deviation**2,
        squares=deviation**2,
        largest=1e-12,
    )
    return Carried(found, *events, carried=share * events[0])


def test_rounds_are_combined_as_those_of_the_event():
    rounds = [carried(1e-7 + e, 1e-9, share=0.1) for e in (-1e-9, 1e-9, 0.0, 1e-9)]
    got = together("injury", rounds, 30, (9e-7, 1.1e-6), 0.95, total=15.0, aimed=True)
    assert got.mean == pytest.approx(1e-7, rel=0.01)
    assert 0.9e-7 < got.interval[0] < 1e-7 < got.interval[1] < 1.1e-7
    assert got.determined
    assert got.aimed


def test_rounds_that_count_for_the_event_count_for_its_consequences():
    """What was expected of a consequence moves much more: few rounds would be left to stop on."""
    rounds = [carried(e * 1e-7, e * 2e-9, share=0.1) for e in (0.6, 0.8, 1.2, 1.1)]
    got = together("injury", rounds, 30, (9e-7, 1.1e-6), 0.95, total=15.0, aimed=True)
    assert got.mean == pytest.approx(np.mean([0.6, 0.8, 1.2, 1.1]) * 1e-7)


def test_a_consequence_never_seen_is_bounded_by_the_draws_alone():
    # forty events of equal weight without it: a classifier is sure, Clopper and Pearson are not
    rounds = [carried(1e-12, 1e-12, events=(1e-6, 1e-13)) for _ in range(4)]
    got = together("rare", rounds, 0, (0.9e-6, 1.1e-6), 0.95, total=0.0, aimed=False)
    assert not got.determined
    assert got.interval[0] == 0.0
    assert got.interval[1] == pytest.approx(1.1e-6 * (1 - 0.025 ** (1 / 40)), rel=1e-6)


@pytest.mark.parametrize(("n_carrying", "total", "share"), [(40, 0.04, 0.1), (40, 9.0, 0.001)])
def test_one_that_was_small_in_all_events_may_be_large_in_the_next(n_carrying, total, share):
    rounds = [carried(1e-9, 1e-11, events=(1e-6, 1e-13), share=share) for _ in range(4)]
    got = together("injury", rounds, n_carrying, (0.9e-6, 1.1e-6), 0.95, total=total, aimed=True)
    assert got.interval[1] > 1.1e-6 * (1 - 0.025 ** (1 / 40))
    plain = together("injury", rounds, 40, (0.9e-6, 1.1e-6), 0.95, total=9.0, aimed=True)
    assert plain.interval[1] < 1.2e-9 or share < 0.01


def test_without_an_event_drawn_a_consequence_may_be_as_likely_as_the_event():
    rounds = [carried(1e-12, 1e-12, events=(0.0, 0.0)) for _ in range(3)]
    got = together("rare", rounds, 0, (0.9e-6, 1.1e-6), 0.95, total=0.0, aimed=False)
    assert got.interval == (0.0, 1.1e-6)


@pytest.mark.parametrize("share", [0.002, 0.02, 0.1])
def test_few_events_with_a_consequence_give_intervals_that_hold(share):
    rng, n, times = np.random.default_rng(7), 60, 400
    held = 0
    for k in binom.rvs(n, share, size=times, random_state=rng):
        found = [carried(1e-12, 1e-12, n, events=(1e-6, 1e-12 / n), share=k / n)]
        low, high = together("rare", found, 0, (1e-6, 1e-6), 0.95, total=0.0, aimed=False).interval
        held += low <= share * 1e-6 <= high
    assert binom.cdf(held, times, 0.95) > 1e-3


def test_where_the_simulator_fails_a_consequence_may_be_all_or_nothing(seen):
    view, y, mean = seen
    failing = view.undecided & (np.arange(len(y)) % 7 == 0)
    assert failing.any()
    rng = np.random.default_rng(12)
    with_it = replace(view, failing=failing)
    drawn = to_estimate(with_it, 6, rng)
    assert not failing[drawn.rows].any()
    got = carry(with_it, drawn, y[drawn.rows], mean[drawn.rows][:, None])[0].round
    assert np.isfinite(got.variance)
    mass = float(view.weights @ failing)
    assert got.highest - got.lowest == pytest.approx(mass)
