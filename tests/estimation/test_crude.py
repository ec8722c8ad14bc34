"""Random encounters, and far situations in turn."""

import numpy as np
import pytest
from scipy.stats import binom

from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.estimation.crude import crude
from crashrate.estimation.encounters import interval
from crashrate.estimation.labels import Labels
from crashrate.estimation.strategy import Problem


@pytest.mark.parametrize(("k", "n"), [(0, 50), (3, 50), (49, 50)])
def test_upper_end_is_clopper_pearson(k, n):
    assert binom.cdf(k, n, interval(k, n, 0.95)[1]) == pytest.approx(0.025)


def test_upper_end_of_nothing_is_one():
    assert interval(0, 0, 0.95)[1] == 1.0
    assert interval(4, 4, 0.95)[1] == 1.0


def begin(cases, max_calls):
    problem = Problem(traffic=cases.standard_normal(2), max_calls=max_calls, batch_size=10)
    return crude(problem, Labels.empty(problem))


def test_ends_with_the_budget_and_an_upper_end(cases, drive):
    end, queries = drive(begin(cases, 35), lambda x: np.zeros(len(x)))
    assert [len(q.x) for q in queries] == [10, 10, 10, 5]
    assert end.probability == 0.0
    assert end.interval == (0.0, interval(0, 20, 0.95)[1])  # far runs bound nothing
    assert end.stop_reason is StopReason.BUDGET_ENDED
    assert end.alarms == (Alarm.NO_CRASH_FOUND,)


def test_a_failed_encounter_counts_as_a_crash_for_the_upper_end(cases, drive):
    def simulate(x):
        return np.where(np.arange(len(x)) == 0, np.nan, 0.0)

    end, _ = drive(begin(cases, 40), simulate)
    assert end.interval[1] == interval(2, 20, 0.95)[1]


def test_stops_at_the_first_crash(cases, drive):
    labels, queries = drive(begin(cases, 5000), lambda x: x[:, 0] > 2)
    assert (labels.y == 1).any()
    assert labels.n == 10 * len(queries) < 1000
    assert not (labels.y[:-10] == 1).any()


def test_finds_a_small_set_that_random_encounters_would_not(cases, drive):
    def inside(x):  # probability 5e-5: crude Monte Carlo takes 20,000 runs
        return ((x - [4.0, -1.0]) ** 2).sum(axis=1) < 0.25

    labels, _ = drive(begin(cases, 1000), inside)
    assert labels.n < 600


def test_far_situations_are_the_same_for_a_larger_budget(cases, drive):
    ends = [drive(begin(cases, n), lambda x: np.zeros(len(x)))[1] for n in (60, 100)]
    asked = [np.concatenate([q.x for q in queries]) for queries in ends]
    assert np.array_equal(asked[0], asked[1][:60])
