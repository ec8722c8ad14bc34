import math

import numpy as np
import pytest
from scipy.stats import binomtest
from scipy.stats import t as student

from crashrate.estimation.tally import Tally


def test_sums_do_not_depend_on_how_the_draws_arrive():
    z = np.random.default_rng(0).exponential(size=100)
    once, twice = Tally().add(z, 2.0), Tally().add(z[:30], 2.0).add(z[30:])
    for name in ("n", "total", "squares", "largest", "failed"):
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
    sure, unsure = (Tally().add(z, failed).interval(0.95, 10.0) for failed in (0.0, 3.0))
    assert unsure[0] == sure[0]
    assert unsure[1] == pytest.approx(sure[1] + 0.03)


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
