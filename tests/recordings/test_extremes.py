"""The extreme-value interval covers a known probability, over many seeds."""

import numpy as np
import pytest
from scipy.stats import genpareto, norm

from crashrate.recordings.extremes import MIN_EXCEEDANCES, Extremes, extremes

N, P = 50_000, 1e-5


def intervals(shape, n_seeds, p=P):
    crash = genpareto.isf(P, shape)
    found = []
    for seed in range(n_seeds):
        rng = np.random.default_rng(seed)
        margins = crash - genpareto.rvs(shape, size=N, random_state=rng)
        found.append(extremes(np.sort(margins)[:400], N).interval)
    low, high = np.array(found).T
    return np.mean((low <= p) & (p <= high))


@pytest.mark.parametrize("shape", [-0.3, 0.0, 0.2])
def test_interval_covers(shape):
    assert intervals(shape, 40) >= 0.85


def test_interval_does_not_hold_anything():
    assert intervals(0.0, 10, p=100 * P) < 0.5


def test_a_law_that_ends_before_a_crash_gives_next_to_nothing():
    rng = np.random.default_rng(0)
    margins = 3.0 - rng.uniform(0, 1, N)  # none comes nearer than 2
    got = extremes(np.sort(margins)[:400], N)
    assert got.probability < 1e-12
    assert got.interval[0] == 0.0


@pytest.mark.parametrize("level", [2.7, 3.2])
def test_events_that_crash_count_as_crashes_however_deep(level):
    """Recorded crashes among the exceedances: censored, the interval still covers."""
    truth, held = norm.sf(level), 0
    for seed in range(30):
        a = np.random.default_rng(seed).normal(size=10_000)
        margins = np.sort(np.log(level / np.maximum(a, 1e-9)))[:600]
        low, high = extremes(margins, 10_000).interval
        held += low <= truth <= high
        assert high > 1.2 * low
    assert held >= 25


def test_too_few_events_say_nothing():
    assert extremes(np.linspace(0.1, 1, MIN_EXCEEDANCES), 1000) is None
    assert extremes(np.linspace(0.1, 1, 200), 20 * MIN_EXCEEDANCES - 20) is None  # a larger part


def test_where_crashes_are_common_nothing_is_extreme():
    margins = np.concatenate([np.full(100, -0.1), np.linspace(0.1, 1, 400)])
    assert extremes(margins, 10_000) is None


def test_events_that_all_crash_say_nothing():
    assert extremes(-np.linspace(0.1, 1, 400), 1000) is None


def test_survives_a_file():
    got = extremes(np.sort(np.random.default_rng(0).exponential(size=300)), 10_000)
    assert Extremes.from_dict(got.to_dict()) == got
