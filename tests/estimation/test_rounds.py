"""Rounds: unbiased whatever the surrogate says, and calibrated together."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import stdtrit
from scipy.stats import norm

from crashrate.estimation.rounds import (
    DRAW_FREEDOM,
    DRAW_WORTH,
    MIN_INFLATION,
    PRIOR_ROUNDS,
    Round,
    combine,
    log_efficiency,
    measure,
    predicted_variance,
)
from crashrate.estimation.selection import to_estimate
from crashrate.estimation.view import View
from crashrate.sampling.gaussians import Gaussians
from crashrate.sampling.pool import draw_pool

TIMES = 3000


def redrawn(view, outcomes, n=6, times=TIMES, forget=None):
    """Estimates of the same pool's crash mass by independent rounds."""
    rng, estimates = np.random.default_rng(0), []
    for _ in range(times):
        drawn = to_estimate(view, n, rng)
        told = drawn if forget is None else replace(drawn, probabilities=forget(drawn))
        estimates.append(measure(view, told, outcomes[drawn.rows]).estimate)
    return np.array(estimates)


@pytest.mark.parametrize("seed", range(3))
def test_a_round_is_unbiased_for_a_wrong_surrogate_and_a_wrong_order(toy_view, check_mean, seed):
    view, outcomes = toy_view(np.random.default_rng(seed))
    truth = float(view.weights @ outcomes)
    assert np.any(view.inner & (outcomes == 0))
    assert abs(view.probability / truth - 1) > 0.5
    check_mean(redrawn(view, outcomes), truth)


def test_trusting_the_surrogate_is_seen_to_be_biased(toy_view, check_mean):
    view, outcomes = toy_view(np.random.default_rng(0))
    trusting = view.probability + 1e-6 * redrawn(view, outcomes, times=100)
    with pytest.raises(AssertionError, match="z ="):
        check_mean(trusting, float(view.weights @ outcomes))


def test_wrong_probabilities_are_seen_to_be_biased(toy_view, check_mean):
    view, outcomes = toy_view(np.random.default_rng(0))
    uniform = redrawn(view, outcomes, forget=lambda _: np.full(len(view.h), 1 / len(view.h)))
    tilted = redrawn(view, outcomes, forget=lambda d: d.probabilities * (1.5 - view.h))
    for estimates in (uniform, tilted):
        with pytest.raises(AssertionError, match="z ="):
            check_mean(estimates, float(view.weights @ outcomes))


def test_predicted_variance_is_seen_where_the_surrogate_is_right(toy_view):
    view, _ = toy_view(np.random.default_rng(4))
    rng, moved = np.random.default_rng(5), []
    for _ in range(6000):
        drawn = to_estimate(view, 6, rng)
        outcomes = (rng.random(len(view.h)) < view.h).astype(float)
        moved.append(measure(view, drawn, outcomes[drawn.rows]).estimate - view.probability)
    expected = predicted_variance(view, drawn.probabilities, 6)
    assert np.var(moved) == pytest.approx(expected, rel=0.12)
    assert measure(view, drawn, outcomes[drawn.rows]).variance == pytest.approx(
        expected + view.pool_variance
    )


def squares_and_errors(cases, hold, n=12, times=3000):
    """What rounds' draws say of their variance, and what it is, where h is held by `hold`."""
    rng = np.random.default_rng(6)
    said, moved = [], []
    proposal = Gaussians(np.ones(1), np.full((1, 2), 0.8), 2 * np.eye(2)[None])
    pool = draw_pool(proposal, cases.standard_normal(2), lambda x: x, 1000, rng)
    h, none = hold(pool.u[:, 0]), np.zeros(1000, dtype=bool)
    view = View(pool, h, h, none, none, none, none, none, ordered=True)
    crashes = (pool.u[:, 0] > 1).astype(float)
    for _ in range(times):
        drawn = to_estimate(view, n, rng)
        found = measure(view, drawn, crashes[drawn.rows])
        said.append(found.squares - view.pool_variance)
        moved.append(found.estimate)
    return np.mean(said), np.var(moved), predicted_variance(view, drawn.probabilities, n)


def test_draws_of_a_surrogate_that_is_too_careful_say_so(cases):
    """A smooth edge is where it is held to be: along h all outcomes are as the surrogate orders."""
    said, true, predicted = squares_and_errors(cases, lambda u: norm.cdf(2 * (u - 1)))
    assert true < said < 0.5 * predicted


def test_draws_of_a_surrogate_that_is_too_sure_say_so(cases):
    said, true, predicted = squares_and_errors(cases, lambda u: norm.cdf(12 * (u - 1.3)))
    assert true > 3 * predicted
    assert 0.8 * true < said < 2.5 * true


@pytest.mark.parametrize("n", [60, 1500])
def test_a_run_that_is_drawn_many_times_counts_once(toy_view, n):
    view, _ = toy_view(np.random.default_rng(4), n=100)
    rng, moved, squares = np.random.default_rng(5), [], []
    for _ in range(3000):
        drawn = to_estimate(view, n, rng)
        outcomes = (rng.random(len(view.h)) < view.h).astype(float)
        got = measure(view, drawn, outcomes[drawn.rows])
        moved.append(got.estimate - view.probability)
        squares.append(got.squares - view.pool_variance)
    predicted = predicted_variance(view, drawn.probabilities, n)
    assert np.var(moved) == pytest.approx(predicted, rel=0.12)
    assert np.mean(squares) == pytest.approx(predicted, rel=0.05)
    assert drawn.rows.shape < (n,)
    # each draw for itself, as if its outcome were another, would promise too much
    alone = float(view.spread**2 @ (1 / (n * drawn.probabilities)))
    assert np.var(moved) > (1.05 if n == 60 else 3) * alone


def test_failed_simulations_bracket_what_they_may_have_been(toy_view):
    view, outcomes = toy_view(np.random.default_rng(6))
    drawn = to_estimate(view, 8, np.random.default_rng(7))
    y = outcomes[drawn.rows]
    failed = y.copy()
    failed[[1, 5]] = np.nan
    got = measure(view, drawn, failed)
    ends = [measure(view, drawn, np.where(np.isnan(failed), e, failed)) for e in (0.0, 1.0)]
    assert got.lowest == pytest.approx(ends[0].estimate)
    assert got.highest == pytest.approx(ends[1].estimate)
    assert got.lowest < got.estimate < got.highest
    whole = measure(view, drawn, y)
    assert whole.lowest == whole.estimate == whole.highest


def test_largest_is_the_move_of_one_run(toy_view):
    view, outcomes = toy_view(np.random.default_rng(8))
    drawn = to_estimate(view, 1, np.random.default_rng(9))
    got = measure(view, drawn, outcomes[drawn.rows])
    assert got.largest == pytest.approx(abs(got.estimate - got.predicted))
    assert got.n_runs == 1


def round_of(estimate, variance, predicted=1.0, fails=0.0, squares=None):
    return Round(
        n_runs=10,
        estimate=estimate,
        lowest=estimate - fails,
        highest=estimate + fails,
        predicted=predicted,
        known=predicted,
        variance=variance,
        squares=variance if squares is None else squares,
        largest=0.1,
    )


def intervals(over_confidence, n_rounds=8, times=2000):
    """Intervals from normal rounds around 0.1, whose true deviations exceed the predicted ones."""
    rng, found = np.random.default_rng(10), []
    for _ in range(times):
        sd = rng.uniform(0.003, 0.03, n_rounds)
        true = over_confidence * sd
        estimates = rng.normal(0.1, true)
        squares = true**2 * rng.chisquare(10, n_rounds) / 10
        rounds = zip(estimates, sd, squares, strict=True)
        found.append(combine([round_of(e, s**2, squares=q) for e, s, q in rounds], 0.95))
    return found


@pytest.mark.parametrize("n_rounds", [3, 8])
@pytest.mark.parametrize(("over_confidence", "least"), [(0.5, 0.95), (1.0, 0.95), (2.0, 0.94)])
def test_intervals_cover_whatever_the_predictions(over_confidence, least, n_rounds):
    found = intervals(over_confidence, n_rounds)
    covered = np.mean([c.lower <= 0.1 <= c.upper for c in found])
    assert covered >= least - 0.01


def test_intervals_of_right_predictions_hold_little_more_than_they_say():
    assert np.mean([c.lower <= 0.1 <= c.upper for c in intervals(1.0)]) < 0.98


def test_predictions_that_are_too_large_narrow_the_interval_within_a_limit(check_coverage):
    found = intervals(0.5, times=400)
    check_coverage([(c.lower, c.upper) for c in found], 0.1)
    wide = [c.half_width for c in intervals(1.0, times=400)]
    narrow = np.mean([c.half_width for c in found]) / np.mean(wide)
    assert math.sqrt(MIN_INFLATION) * 0.8 < narrow < 0.95


def test_draws_as_large_as_predicted_keep_the_interval():
    calm = [0.5 + e / 1000 for e in (-0.1, 0.1) * 8]
    predicted = combine([round_of(e, 0.01, squares=0.01) for e in calm], 0.95)
    smaller = combine([round_of(e, 0.01, squares=0.001) for e in calm], 0.95)
    assert 0.9 * 0.025 < predicted.standard_error < 0.025  # the rounds hardly scatter
    assert smaller.standard_error == pytest.approx(0.025 * math.sqrt(MIN_INFLATION))


def widened_by_ten_deviations(variance):
    """Of six late rounds of variance 1e-6 and one more, as much as ten deviations off."""
    late = [round_of(0.1 + e * 1e-3, 1e-6) for e in (-1, 1, -1, 1, -1, 1)]
    off = 10 * math.sqrt(variance)
    as_predicted, surprising = (
        combine([round_of(0.1 + shift, variance, squares=shift**2), *late], 0.95)
        for shift in (math.sqrt(variance), off)
    )
    return surprising.half_width / as_predicted.half_width


def test_a_surprise_widens_the_interval_by_its_part_in_the_estimate():
    assert 1 < widened_by_ten_deviations(1e-4) < 1.2  # a hundredth of the late ones' weight
    assert widened_by_ten_deviations(1e-6) > 2


def test_rounds_count_by_their_part():
    alike = combine([round_of(0.1, 1e-6)] * 5, 0.95)
    one_hardly = combine([round_of(0.1, 1e-2), *[round_of(0.1, 1e-6)] * 5], 0.95)
    assert one_hardly.n_rounds == 6
    assert one_hardly.freedom == pytest.approx(alike.freedom, rel=1e-3)
    assert combine([round_of(0.1, 1e-6)] * 6, 0.95).freedom > alike.freedom + 1


def test_intervals_of_calibrated_rounds_pass_the_coverage_check(check_coverage):
    found = intervals(1.0, times=400)
    check_coverage([(c.lower, c.upper) for c in found], 0.1)


@pytest.mark.parametrize("spoil", ["halved twice", "shifted"])
def test_spoilt_intervals_fail_the_coverage_check(check_coverage, spoil):
    found = intervals(1.0, times=40)
    if spoil == "shifted":
        spoilt = [(c.lower + c.half_width, c.upper + c.half_width) for c in found]
    else:
        ends = [c.half_width / 4 for c in found]
        spoilt = [(c.estimate - e, c.estimate + e) for c, e in zip(found, ends, strict=True)]
    with pytest.raises(AssertionError, match="intervals hold"):
        check_coverage(spoilt, 0.1)


def test_combined_mean_is_unbiased(check_mean):
    check_mean([c.estimate for c in intervals(1.5)], 0.1)


def test_one_round_is_its_own_combination():
    got = combine([round_of(0.5, 0.01)], 0.95)
    assert got.estimate == 0.5
    assert got.standard_error == pytest.approx(0.1)
    assert got.freedom == PRIOR_ROUNDS + DRAW_FREEDOM * DRAW_WORTH * 10
    assert got.half_width == pytest.approx(0.1 * stdtrit(got.freedom, 0.975))


def test_scatter_widens_the_interval():
    calm = combine([round_of(0.5 + e / 4, 0.01 / 16) for e in (-0.1, 0.1, -0.1, 0.1)], 0.95)
    wild = combine([round_of(0.5 + e / 4, 0.01 / 16) for e in (-0.9, 0.9, -0.9, 0.9)], 0.95)
    assert calm.estimate == pytest.approx(wild.estimate)
    assert calm.scatter == pytest.approx(1)
    assert wild.scatter == pytest.approx(81)
    assert wild.half_width > 5 * calm.half_width


def test_a_round_that_predicted_far_too_much_is_noise():
    usual = [round_of(e, 1e-4, predicted=0.1) for e in (0.11, 0.09, 0.1, 0.1)]
    wild = round_of(-0.4, 1.0, predicted=7.0)  # a smaller coefficient of variation than the others
    got, without = combine([*usual, wild], 0.95), combine(usual, 0.95)
    assert got.estimate == pytest.approx(without.estimate, abs=0.002)
    assert got.half_width < 1.1 * without.half_width


def test_rounds_are_weighted_by_their_coefficient_of_variation():
    # less mass at a deviation as much smaller: no better, and no more weight
    rounds = [round_of(0.1, 1e-4, predicted=0.1), round_of(0.08, 0.64e-4, predicted=0.08)]
    assert combine(rounds, 0.95).estimate == pytest.approx(0.09)


def test_surprising_draws_widen_the_interval():
    calm = combine([round_of(0.5, 1e-3) for _ in range(4)], 0.95)
    surprised = combine([round_of(0.5, 1e-3, squares=9e-3) for _ in range(4)], 0.95)
    assert 2 * calm.half_width < surprised.half_width < 3 * calm.half_width
    assert surprised.estimate == calm.estimate


def test_failed_simulations_widen_the_interval_to_both_sides():
    rounds = [round_of(0.5, 0.001, fails=0.2) for _ in range(4)]
    got = combine(rounds, 0.95)
    assert got.lower == pytest.approx(0.3 - got.half_width)
    assert got.upper == pytest.approx(0.7 + got.half_width)


def test_interval_stays_within_zero_and_one():
    got = combine([round_of(0.5, 9.0)], 0.95)
    assert (got.lower, got.upper) == (0.0, 1.0)


def test_an_estimate_above_one_is_one():
    got = combine([round_of(1.002, 1e-5)], 0.95)
    assert got.estimate == got.upper == 1.0
    assert got.half_width > 0.002
    assert got.lower == pytest.approx(1 - got.half_width)


def test_an_estimate_below_zero_is_zero():
    got = combine([round_of(-0.1, 0.01)], 0.95)
    assert got.estimate == got.lower == 0.0
    assert got.upper == pytest.approx(got.half_width)


@pytest.mark.parametrize("estimate", [1.002, -0.002])
def test_no_interval_excludes_every_probability(estimate):
    """An estimate outside [0, 1] by more than its half-width: an interval turned inside out."""
    got = combine([round_of(estimate, 1e-9)], 0.95)
    assert got.half_width < 0.002
    assert got.upper - got.lower == pytest.approx(0.002)
    assert got.lower <= got.estimate <= got.upper


def test_a_larger_confidence_is_a_wider_interval():
    rounds = [round_of(0.5, 0.001) for _ in range(5)]
    assert combine(rounds, 0.99).half_width > combine(rounds, 0.9).half_width


def test_log_efficiency_of_crude_monte_carlo_is_one():
    p, n = 1e-3, 50
    crude = replace(combine([round_of(p, 1e-8)], 0.95), standard_error=math.sqrt(p * (1 - p) / n))
    assert log_efficiency(crude, n) == pytest.approx(1.0)
    exact = replace(crude, standard_error=0.0)
    assert log_efficiency(exact, n) == pytest.approx(2.0)
    assert math.isnan(log_efficiency(replace(crude, estimate=0.0), n))


def test_the_least_inflation_holds():
    calm = [round_of(0.5 + e / 1000, 0.01, squares=0.001) for e in (-0.1, 0.1) * 8]
    assert combine(calm, 0.95).inflation == MIN_INFLATION
    doubted = combine(calm, 0.95, 1.3)
    assert doubted.inflation == 1.3
    assert doubted.freedom == combine(calm, 0.95).freedom > PRIOR_ROUNDS + len(calm) - 1


def noisy_intervals(noise, times=1500):
    """Of five rounds whose draws are as predicted, and that scatter by `noise` of it beside."""
    rng, found = np.random.default_rng(11), []
    for _ in range(times):
        estimates = 0.1 + 0.01 * math.sqrt(1 + noise) * rng.standard_normal(5)
        squares = 1e-4 * rng.chisquare(10, 5) / 10
        rounds = [round_of(e, 1e-4, squares=q) for e, q in zip(estimates, squares, strict=True)]
        found.append(combine(rounds, 0.95))
    return found


@pytest.mark.parametrize(("noise", "least"), [(0.0, 0.96), (1.0, 0.92)])
def test_scatter_that_no_draw_sees_widens_the_interval(noise, least):
    """A pool that misses crashes: the draws of its own round know nothing of it."""
    found = noisy_intervals(noise)
    assert np.mean([c.lower <= 0.1 <= c.upper for c in found]) > least
    if noise:  # the check can fail
        blind = [1.96 * c.standard_error / math.sqrt(c.inflation) for c in found]
        errors = [abs(c.estimate - 0.1) for c in found]
        assert np.mean([e < b for e, b in zip(errors, blind, strict=True)]) < 0.85
