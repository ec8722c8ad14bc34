"""The order is tested where it decides."""

from dataclasses import replace

import numpy as np
import pytest

from crashrate.estimation.alarms import Alarm
from crashrate.estimation.encounters import Encounters, interval
from crashrate.estimation.exploration import inflated
from crashrate.estimation.probing import reachable
from crashrate.sampling.pool import draw_pool


@pytest.mark.parametrize("method", ["sequential", "huang2017"])
@pytest.mark.parametrize("seed", [0, 1])
def test_crashes_at_the_harmless_end_are_noticed(cases, method, seed):
    case = cases.half_plane(1e-4)
    far = 3.8906  # |x| beyond it with probability 1e-4, half of it on the side declared safe

    def simulate(x):
        return np.abs(x[:, 0]) > far

    got = replace(case, crash=simulate).estimate(seed, max_calls=200, method=method)
    assert {Alarm.ORDER_DROPPED, Alarm.ORDER_CONTRADICTED} & set(got.alarms)


def test_encounters_speak_against_an_estimate_far_below_them():
    assert Encounters(30, 5).speak_against(1e-3)
    assert not Encounters(30, 0).speak_against(1e-9)
    assert not Encounters(30, 5).speak_against(0.1)


def test_failed_encounters_may_have_been_safe():
    assert Encounters(10, 5).speak_against(0.1)
    assert not Encounters(10, 5, 20).speak_against(0.1)


def test_interval_without_runs_is_everything():
    assert interval(0, 0, 0.95) == (0.0, 1.0)


def test_where_a_crash_would_matter_knows_the_number_of_variables(cases):
    """Crashes on the other side are as likely, but not each as likely as the likeliest one."""
    for d in (2, 10):
        traffic, rng = cases.standard_normal(d), np.random.default_rng(d)
        wide = inflated(traffic, (1.0, 4.0))
        pool = draw_pool(wide, traffic, lambda x: x, 80_000, rng)
        x = np.zeros((1, d))
        x[0, 0] = 4.0
        rows = reachable(pool, float(traffic.log_density(x)[0]))
        assert (pool.x[rows, 0] < -4.0).sum() > 10
        assert len(rows) < len(reachable(pool))
