import math

import numpy as np
import pytest
from scipy.stats import binomtest
from scipy.stats import t as student

from crashrate.estimation.tally import Tally


def test_sums_do_not_depend_on_how_the_draws_arrive():
    z = np.random.default_rng(0).exponential(size=100)
    lost = np.array([0.5, 1.5])
    once, twice = Tally().add(z, lost), Tally().add(z[:30], lost[:1]).add(z[30:], lost[1:])
    for name in ("n", "total", "squares", "largest", "failed", "failed_squares", "n_zero"):
        assert getattr(once, name) == pytest.approx(getattr(twice, name))


def test_mean_error_and_interval_are_those_of_the_sample():
    z = np.random.default_rng(0).exponential(size=400) / 10
    tally = Tally().add(z)
    assert tally.mean == pytest.approx(z.mean())
    assert tally.standard_error == pytest.approx(z.std(ddof=1) / 20)
    low, high = tally.interval(0.95, 1.0)
    assert (high + low) / 2 == pytest.approx(z.mean())
    t = student.ppf(0.975, tally.n_eff - 1)
    assert 1.96 < t < 1.98
    assert (high - low) / 2 == pytest.approx(t * tally.standard_error)
    assert tally.largest_share == pytest.approx(z.max() / z.sum())


def test_equal_weights_count_fully():
    tally = Tally().add(np.repeat([0.5, 0.0], [7, 93]))
    assert tally.n_eff == pytest.approx(7)
    assert tally.log_efficiency == pytest.approx(math.log(0.0175) / math.log(0.035))


def test_crude_monte_carlo_has_log_efficiency_one():
    assert Tally().add(np.repeat([1.0, 0.0], [3, 997])).log_efficiency == pytest.approx(1)


def test_failed_draws_widen_the_interval_by_what_they_could_add():
    z = np.repeat([0.1, 0.0], [10, 90])
    lost = np.full(30, 0.1)
    sure, unsure = (Tally().add(z, w).interval(0.95, 10.0) for w in (None, lost))
    assert unsure[0] == sure[0]
    as_crashes = Tally().add(np.repeat([0.1, 0.0], [40, 60])).interval(0.95, 10.0)
    assert unsure[1] == pytest.approx(as_crashes[1])


def test_a_failed_draw_takes_nothing_off_the_upper_end():
    """Without a crash it is the exact one: a tiny failed weight once stood in its place."""
    lost = np.array([1e-9])
    sure, unsure = (Tally().add(np.zeros(100), w).interval(0.95, 10.0) for w in (None, lost))
    assert unsure == sure == (0.0, pytest.approx(10 * binomtest(0, 100).proportion_ci().high))


def test_draws_that_all_crash_leave_an_exact_lower_end():
    """Equal weights have no scatter, and say nothing of what no draw met."""
    low, high = Tally().add(np.ones(100)).interval(0.95, 2.0)
    exact = binomtest(0, 100).proportion_ci(0.95, method="exact").high
    assert (low, high) == (pytest.approx(1 - 2 * exact), 1.0)


def test_no_crash_leaves_an_exact_upper_end():
    low, high = Tally().add(np.zeros(50)).interval(0.95, 2.0)
    exact = binomtest(0, 50).proportion_ci(0.95, method="exact").high
    assert (low, high) == (0.0, pytest.approx(2 * exact))


def test_nothing_is_known_at_first():
    tally = Tally()
    assert math.isnan(tally.mean)
    assert tally.standard_error == math.inf
    assert tally.interval(0.95, 10.0) == (0.0, 1.0)
    assert tally.n_eff == 0.0
    assert math.isnan(tally.log_efficiency)


def test_few_unequal_weights_widen_the_interval():
    z = np.zeros(1000)
    z[:3] = [0.1, 0.2, 0.05]
    tally = Tally().add(z)
    assert 2 < tally.n_eff < 3
    assert tally.half_width(0.95) > 4 * tally.standard_error
