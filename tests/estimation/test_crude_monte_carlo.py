"""Crude Monte Carlo with inverse sampling: exact sums over every way in which it can end."""

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import binom, nbinom, norm

from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.estimation.crude_monte_carlo import (
    crude_monte_carlo,
    enough,
    inverse_interval,
)
from crashrate.estimation.encounters import Encounters, interval
from crashrate.estimation.strategy import Problem

TARGET = 0.4


def problem(cases, **changes):
    return Problem(
        **{"traffic": cases.standard_normal(1), "relative_half_width": TARGET, "batch_size": 7}
        | changes
    )


def n_crashes(target=TARGET):
    return next(k for k in range(2, 10_000) if enough(Encounters(k, k), target, 0.95))


def endings(p, budget):
    """Probability, estimate and interval of every end: the k-th crash, or the budget before it."""
    k = n_crashes()
    for n in range(k, budget + 1):
        ends = inverse_interval(Encounters(n, k), 0.95)
        yield nbinom.pmf(n - k, k, p), (k - 1) / (n - 1), ends, k / n
    for m in range(k):
        yield binom.pmf(m, budget, p), m / budget, interval(m, budget, 0.95), m / budget


@pytest.mark.parametrize("p", [0.3, 0.1, 0.01])
@pytest.mark.parametrize("budget", [60, 400])
def test_exactly_unbiased_and_covering_whatever_ends_it(p, budget):
    chance, mean, ends, naive = zip(*endings(p, budget), strict=True)
    chance, (low, high) = np.array(chance), np.array(ends).T
    assert chance.sum() == pytest.approx(1, abs=1e-9)
    assert chance @ mean == pytest.approx(p, rel=1e-9)
    assert chance[(low <= p) & (p <= high)].sum() >= 0.95
    assert chance[p < low].sum() <= 0.025
    assert chance[p > high].sum() <= 0.025
    if n_crashes() < p * budget:  # negative control: the share of crashes at the k-th of them
        assert chance @ naive > 1.02 * p


@pytest.mark.parametrize("p", [0.3, 0.1])
def test_stopping_when_the_interval_is_narrow_is_noticed(p, check_mean):
    """Negative control: the share of crashes at the first run after which it meets the target."""
    rng, shares, n = np.random.default_rng(0), [], np.arange(1, 1501)
    for _ in range(1500):
        k = np.cumsum(rng.random(1500) < p)
        half = 1.96 * np.sqrt(k * (n - k) / n) / np.maximum(k, 1)
        first = int(np.argmax((half <= TARGET) & (k > 1)))
        shares.append(k[first] / n[first])
    with pytest.raises(AssertionError, match="mean"):
        check_mean(shares, p)


@pytest.mark.parametrize("target", [1.0, 0.3, 0.1])
@pytest.mark.parametrize("p", [1e-4, 0.01, 0.3, 0.9])
def test_enough_crashes_meet_the_target_however_many_runs_they_took(target, p):
    k = n_crashes(target)
    for n in {max(k, int(nbinom.ppf(q, k, p)) + k) for q in (0.001, 0.5, 0.999)}:
        low, high = inverse_interval(Encounters(n, k), 0.95)
        assert (high - low) / 2 <= target * (k - 1) / (n - 1) * (1 + 1e-9)


def crashes(p):
    return lambda x: x[:, 0] < norm.ppf(p)


@pytest.mark.parametrize("p", [0.3, 0.1])
def test_covers_without_bias_over_seeds(cases, drive, check_coverage, check_mean, p):
    ends = [drive(crude_monte_carlo(problem(cases, seed=s)), crashes(p))[0] for s in range(150)]
    assert {s.stop_reason for s in ends} == {StopReason.TARGET_MET}
    check_coverage([s.interval for s in ends], p)
    check_mean([s.probability for s in ends], p)
    for s in ends:
        assert (s.interval[1] - s.interval[0]) / 2 <= TARGET * s.probability * (1 + 1e-9)


def test_failed_runs_widen_it_to_all_that_they_may_be(cases, drive, check_coverage):
    """A tenth of the crashes and a hundredth of the safe runs fail: p is 0.2."""

    def simulate(x):
        u = np.modf(np.abs(x[:, 0]) * 1e6)[0]
        return np.where(u < 0.02, np.nan, np.where(u < 0.2, 1.0, np.where(u > 0.992, np.nan, 0.0)))

    ends = [drive(crude_monte_carlo(problem(cases, seed=s)), simulate)[0] for s in range(200)]
    check_coverage([s.interval for s in ends], 0.2)
    assert {s.stop_reason for s in ends} == {StopReason.TARGET_MET}
    sure = inverse_interval(Encounters(100, 20), 0.95)
    unsure = inverse_interval(Encounters(95, 20, 5), 0.95)
    assert unsure[0] == sure[0]
    assert unsure[1] == pytest.approx(interval(24, 99, 0.95)[1])


def test_too_many_failed_runs_keep_it_from_its_target(cases, drive):
    def simulate(x):
        return np.where(x[:, 0] > 0.5, np.nan, (x[:, 0] < -0.5).astype(float))

    end, _ = drive(crude_monte_carlo(problem(cases, max_calls=500)), simulate)
    assert end.stop_reason is StopReason.BUDGET_ENDED
    assert end.interval[0] < 0.31
    assert end.interval[1] > 0.61
    assert end.probability == pytest.approx(0.5, abs=0.1)


def test_no_crash_leaves_the_exact_upper_end(cases, drive):
    end, queries = drive(
        crude_monte_carlo(problem(cases, max_calls=50)), lambda x: np.zeros(len(x))
    )
    assert [len(q.x) for q in queries] == [7] * 7 + [1]
    assert (end.probability, end.interval) == (0.0, interval(0, 50, 0.95))
    assert end.alarms == (Alarm.NO_CRASH_FOUND,)
    assert end.stop_reason is StopReason.BUDGET_ENDED


def test_nothing_is_claimed_where_every_run_failed(cases, drive):
    end, _ = drive(
        crude_monte_carlo(problem(cases, max_calls=15)), lambda x: np.full(len(x), np.nan)
    )
    assert math.isnan(end.probability)
    assert end.interval == (0.0, 1.0)


def test_every_run_a_crash(cases, drive):
    end, _ = drive(crude_monte_carlo(problem(cases)), lambda x: np.ones(len(x)))
    assert end.probability == 1.0
    assert end.interval[1] == 1.0
    assert end.stop_reason is StopReason.TARGET_MET


def test_a_larger_budget_and_a_narrower_target_go_on_with_the_same_draws(cases, drive):
    runs = [
        drive(crude_monte_carlo(problem(cases, **changes)), crashes(0.1))
        for changes in ({"max_calls": 70}, {}, {"relative_half_width": 0.2})
    ]
    draws = [np.concatenate([q.x for q in queries]) for _, queries in runs]
    for fewer, more in pairwise(draws):
        assert len(fewer) < len(more)
        np.testing.assert_array_equal(fewer, more[: len(fewer)])
    assert [end.stop_reason for end, _ in runs] == [
        StopReason.BUDGET_ENDED, StopReason.TARGET_MET, StopReason.TARGET_MET,
    ]  # fmt: skip


def test_a_wider_target_leaves_nothing_out_that_is_stored(cases, drive):
    stored = drive(crude_monte_carlo(problem(cases, relative_half_width=0.2)), crashes(0.1))
    n = sum(len(q.x) for q in stored[1])
    asked = problem(cases, relative_half_width=0.5, earlier_targets=((0.2, n),))
    end, queries = drive(crude_monte_carlo(asked), crashes(0.1))
    assert sum(len(q.x) for q in queries) == n
    assert end.n_eff == pytest.approx(stored[0].n_eff, abs=7)
