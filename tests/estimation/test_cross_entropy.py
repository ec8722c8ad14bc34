"""The cross-entropy method against exact answers."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from crashrate.estimation import cross_entropy as module
from crashrate.estimation import exploration
from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.estimation.cross_entropy import cross_entropy
from crashrate.estimation.weighted_draws import WeightedDraws
from crashrate.traffic.model import TrafficModel

P = 1e-4
N_SEEDS = 16
pytestmark = pytest.mark.usefixtures("quick")


@pytest.fixture
def quick(monkeypatch):
    """Fewer runs before the estimate, and a smaller pool to explore in: the same otherwise."""
    monkeypatch.setattr(module, "N_FIRST", 200)
    monkeypatch.setattr(module, "N_PER_ITERATION", 100)
    monkeypatch.setattr(exploration, "N_WIDE", 4000)


def finished(case, seed=0, **options):
    return case.estimate(
        seed, **{"method": "cross-entropy", "relative_half_width": 0.2, "max_calls": 5000} | options
    )


@pytest.fixture
def half_plane(cases):
    return cases.half_plane(P)


def test_unbiased_and_covering_over_seeds(half_plane, check_coverage, check_mean):
    got = [finished(half_plane, seed) for seed in range(N_SEEDS)]
    assert {g.stop_reason for g in got} == {StopReason.TARGET_MET}
    assert all(g.relative_half_width <= 0.2 for g in got)
    check_coverage([g.interval for g in got], P)
    check_mean([g.probability for g in got], P)
    assert all(g.alarms == (Alarm.NO_ORDER,) for g in got)


def test_dropped_weights_are_noticed(half_plane, check_coverage, monkeypatch):
    """Negative control: crashes of the proposal counted as if they were traffic's."""

    def unweighted(self, w, *rest):
        return add(self, np.ones_like(w), *rest)

    add = WeightedDraws.add
    monkeypatch.setattr(WeightedDraws, "add", unweighted)
    got = [finished(half_plane, seed) for seed in range(4)]
    with pytest.raises(AssertionError, match="0 of 4"):
        check_coverage([g.interval for g in got], P)


def test_two_crash_regions_are_both_counted(cases, check_coverage):
    """Without an order, one with four times the other's probability."""
    case = cases.half_plane(P)
    top, bottom = norm.isf(0.8 * P), norm.ppf(0.2 * P)
    both = replace(case, risk=None, crash=lambda x: (x[:, 0] > top) | (x[:, 0] < bottom))
    check_coverage([finished(both, seed).interval for seed in range(8)], P)


def test_a_budget_that_is_too_small_says_so(half_plane):
    for max_calls in (1, 37, 300, 1100):
        got = finished(half_plane, max_calls=max_calls, relative_half_width=0.01)
        assert got.n_calls == max_calls
        assert got.stop_reason is StopReason.BUDGET_ENDED
        assert Alarm.TARGET_NOT_REACHED in got.alarms
        assert got.interval[0] <= P <= got.interval[1]
        if max_calls < 500:
            assert math.isnan(got.probability) or got.probability == 0.0
            assert got.interval == (0.0, 1.0)


def test_a_larger_budget_goes_on_with_the_same_draws(half_plane):
    def drawn(max_calls):
        campaign = half_plane.campaign(
            method="cross-entropy", max_calls=max_calls, relative_half_width=0.01
        )
        while not campaign.done:
            campaign.tell(half_plane.crash(campaign.ask()))
        return campaign.x

    longest = drawn(1300)
    for max_calls in (20, 203, 555, 1111):
        np.testing.assert_array_equal(drawn(max_calls), longest[:max_calls])


def test_no_crash_leaves_what_random_encounters_leave(cases):
    got = finished(cases.never(), max_calls=500)
    assert got.probability == 0.0
    assert 0.005 < got.interval[1] < 0.05
    assert Alarm.NO_CRASH_FOUND in got.alarms


def test_failed_simulations_widen_the_interval(half_plane, check_coverage):
    """A third of the crashes far from the diagonal fail."""

    def simulate(x):
        crash = half_plane.crash(x)
        return np.where(crash & (x[:, 0] - x[:, 1] > 0.6), np.nan, crash)

    got = [finished(replace(half_plane, crash=simulate), s, max_calls=1500) for s in range(4)]
    check_coverage([g.interval for g in got], P)
    assert all(g.interval[1] > 1.3 * g.probability for g in got)
    assert all(Alarm.SIMULATIONS_FAILED in g.alarms for g in got)


def test_draws_outside_the_box_cost_nothing(cases, check_coverage):
    """A half-normal: most draws of a proposal at its edge lie beyond."""
    traffic = TrafficModel(
        [1.0], np.zeros((1, 2)), np.eye(2)[None], [0.0, 3.0], [np.inf] * 2, ("a", "b")
    )
    level = norm.isf(P / 2)
    case = replace(cases.half_plane(P), traffic=traffic, crash=lambda x: x[:, 0] >= level)
    got = [finished(case, seed) for seed in range(4)]
    check_coverage([g.interval for g in got], P)


def test_phases_are_named(half_plane, drive):
    problem = half_plane.campaign(max_calls=900).problem
    end, queries = drive(cross_entropy(problem), half_plane.crash)
    phases = list(dict.fromkeys(q.snapshot.phase for q in queries))
    assert phases[:2] == ["explore", "adapt 1"]
    assert phases[-1] == "estimate" == end.phase
