"""Campaigns that once failed: by an exception, without an estimate, or confidently wrong."""

import numpy as np
import pytest
from scipy.stats import norm, truncnorm

from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.estimation.run import estimate
from crashrate.traffic.model import TrafficModel


def in_a_box(d, spread):
    """As good as uniform on the unit cube, and the size of the corner that holds `p`."""
    names = tuple("abcdefghij"[:d])
    traffic = TrafficModel(
        [1.0], np.full((1, d), 0.5), spread**2 * np.eye(d)[None], [0.0] * d, [1.0] * d, names
    )
    law = truncnorm(-0.5 / spread, 0.5 / spread, 0.5, spread)
    return traffic, lambda p: law.isf(p ** (1 / d))


@pytest.mark.parametrize(("d", "spread"), [(3, 10.0), (10, 1.0)])
def test_traffic_much_wider_than_its_box(cases, d, spread):
    traffic, corner = in_a_box(d, spread)
    level = corner(1e-2)
    crash = lambda x: (x > level).all(axis=1)  # noqa: E731
    got = estimate(crash, traffic, risk=cases.increasing(d), max_calls=120, relative_half_width=0.5)
    assert got.interval[0] <= 1e-2 <= got.interval[1]
    assert got.n_crashes > 0


def test_a_corner_of_the_box_that_no_draw_reaches(cases):
    """Two of six misses have a chance of 3 % at 95 % coverage; half of p would miss six times."""
    traffic, corner = in_a_box(2, 1.0)
    level = corner(1e-6)
    crash = lambda x: (x > level).all(axis=1)  # noqa: E731
    got = [
        estimate(crash, traffic, risk=cases.increasing(2), seed=seed, max_calls=200)
        for seed in range(6)
    ]
    assert all(g.stop_reason is StopReason.TARGET_MET for g in got)
    assert sum(g.interval[0] <= 1e-6 <= g.interval[1] for g in got) >= 5
    assert not any(Alarm.ORDER_DROPPED in g.alarms for g in got)


@pytest.mark.parametrize("p", [1e-8, 1e-9])
def test_the_rarest_events_without_an_order(cases, p):
    """What was taken as safe for want of an order held a hundred times their probability."""
    got = cases.tail(p).estimate(risk=None, max_calls=300)
    assert got.stop_reason is StopReason.TARGET_MET
    assert got.interval[0] <= p <= got.interval[1]


def test_ten_coordinates_are_within_a_few_hundred_runs(cases):
    """An edge that is a plane: effects that add up are learned a coordinate at a time."""
    got = cases.half_plane(1e-6, d=10).estimate(max_calls=450, relative_half_width=0.15)
    assert got.stop_reason is StopReason.TARGET_MET
    assert got.interval[0] <= 1e-6 <= got.interval[1]


@pytest.mark.parametrize("batch_size", [50, 1000])
def test_large_batches_are_grown_into(cases, batch_size):
    campaign = cases.half_plane(1e-6).campaign(batch_size=batch_size, max_calls=1000)
    sizes = []
    while not campaign.done:
        sizes.append(len(x := campaign.ask()))
        campaign.tell(x.sum(axis=1) >= np.sqrt(2) * norm.isf(1e-6))
    got = campaign.estimate()
    assert got.stop_reason is StopReason.TARGET_MET
    assert got.interval[0] <= 1e-6 <= got.interval[1]
    assert max(sizes) <= min(batch_size, got.n_calls)
    assert got.n_calls < 300


def test_a_thin_oblique_strip_without_an_order_is_all_found(cases):
    """Round kernels lost a tenth to a third of it, in seven of twelve narrow intervals."""

    def crash(x):
        across = x.sum(axis=1) / np.sqrt(2)
        return (across >= 3.5) & (across <= 3.8)

    p = norm.sf(3.5) - norm.sf(3.8)
    got = [estimate(crash, cases.standard_normal(2), seed=seed) for seed in (8, 10, 11)]
    assert sum(g.interval[0] <= p <= g.interval[1] for g in got) >= 2
    assert np.mean([g.probability for g in got]) == pytest.approx(p, rel=0.06)


def test_random_outcomes_without_an_order_have_no_narrow_interval_elsewhere(cases):
    """Where a crash is unlikely everywhere no threshold says what is safe; half was lost by one."""
    rng = np.random.default_rng(0)
    traffic, p = cases.standard_normal(2), norm.cdf(-4.5 / np.sqrt(1.16))

    def crash(x):
        return rng.random(len(x)) < norm.cdf((x[:, 0] - 4.5) / 0.4)

    got = estimate(crash, traffic, max_calls=250)
    assert got.interval[0] <= p <= got.interval[1]


def test_a_side_on_which_the_simulator_fails_widens_the_interval(cases):
    traffic, p = cases.standard_normal(2), norm.sf(4.26)

    def crash(x):
        return np.where(x[:, 0] < -4.26, np.nan, x[:, 0] > 4.26)

    got = [estimate(crash, traffic, max_calls=250, seed=seed) for seed in range(1, 4)]
    assert all(Alarm.SIMULATIONS_FAILED in g.alarms for g in got)
    assert all(g.interval[0] <= 1.05 * p for g in got)
    upper = [g.interval[1] / p for g in got]  # 2 where all those would crash
    assert min(upper) > 1.1
    assert max(upper) > 2.0


def test_failures_at_random_cost_little(cases):
    rng = np.random.default_rng(3)
    case = cases.half_plane(1e-6)

    def crash(x):
        return np.where(rng.random(len(x)) < 0.05, np.nan, case.crash(x))

    got = estimate(crash, case.traffic, risk=case.risk, max_calls=200, relative_half_width=0.2)
    assert got.n_failed > 0
    assert got.stop_reason is StopReason.TARGET_MET
    assert got.interval[0] <= 1e-6 <= got.interval[1]


def test_an_order_that_is_false_far_from_the_edge_is_often_noticed(cases):
    """Crashes also where one coordinate is low and another high: forty times as many."""
    traffic, p = cases.standard_normal(3), 1e-6 + norm.cdf(-2.5) ** 2

    def crash(x):
        return (x.sum(axis=1) > np.sqrt(3) * norm.isf(1e-6)) | ((x[:, 0] < -2.5) & (x[:, 1] > 2.5))

    got = [
        estimate(crash, traffic, risk=cases.increasing(3), seed=seed, max_calls=150)
        for seed in range(6)
    ]
    noticed = [g for g in got if Alarm.ORDER_DROPPED in g.alarms]
    assert len(noticed) >= 3
    assert all(g.interval[0] <= p <= g.interval[1] for g in noticed)
