"""What the draws of a proposal say, and when it is not to be believed."""

import numpy as np
import pytest

from crashrate.estimation.alarms import Alarm
from crashrate.estimation.encounters import interval
from crashrate.estimation.weighted_draws import MAX_TAIL_INDEX, WeightedDraws, tail_index


def draws(w, *, n=None, came=None, y=None):
    w = np.asarray(w, float)
    y = np.ones(len(w)) if y is None else np.asarray(y, float)
    came = np.zeros(len(w), bool) if came is None else came
    return WeightedDraws(0.1).add(w, y, came, n or len(w))


@pytest.mark.parametrize("index", [0.3, 1.0, 2.0])
def test_tail_index_of_pareto_weights(index):
    w = np.random.default_rng(0).random(20_000) ** -index
    assert tail_index(w) == pytest.approx(index, rel=0.15)


def test_equal_weights_have_no_tail_and_few_have_an_unknown_one():
    assert tail_index(np.ones(50)) == 0.0
    assert tail_index(np.ones(19)) == np.inf


def test_nothing_is_known_at_first():
    nothing = WeightedDraws(0.1)
    assert nothing.interval(0.95) == (0.0, 1.0)
    assert nothing.alarms(0.95) == ()


def test_equal_weights_are_trusted():
    few = draws(np.full(100, 1e-5), n=400)
    low, high = few.interval(0.95)
    assert few.trusted
    assert few.tally.mean == pytest.approx(2.5e-6)
    assert 1.8e-6 < low < 2.5e-6 < high < 3.3e-6
    assert few.alarms(0.95) == ()


def test_heavy_weights_leave_only_ordinary_traffic():
    w = 1e-7 * np.random.default_rng(0).random(400) ** -1.5
    came = np.arange(800) < 80
    y = np.repeat([0, 1], 400)
    heavy = draws(np.concatenate([np.ones(400), w]), y=y, came=came)
    assert heavy.tail_index > MAX_TAIL_INDEX
    assert heavy.interval(0.95)[1] == interval(0, 80, 0.95)[1]
    assert Alarm.WEIGHTS_HEAVY_TAILED in heavy.alarms(0.95)


def test_few_crashes_leave_only_ordinary_traffic():
    few = draws(np.repeat([0.5, 1e-6], [90, 9]), y=np.repeat([0, 1], [90, 9]),
                came=np.arange(99) < 50)  # fmt: skip
    assert few.interval(0.95)[1] == interval(0, 50, 0.95)[1]
    assert Alarm.TOO_FEW_CRASHES in few.alarms(0.95)


def test_ordinary_draws_that_crash_far_too_often_speak_against_the_weights():
    """Ten of a hundred ordinary draws crash where the weights say one in a hundred thousand."""
    odd = draws(np.full(1000, 1e-5), came=np.arange(1000) < 10)
    assert odd.interval(0.95)[1] > 0.99
    assert Alarm.ENCOUNTERS_DISAGREE in odd.alarms(0.95)


def test_failed_draws_count_either_way():
    sure = draws(np.full(100, 1e-3), n=1000)
    unsure = sure.add(np.full(5, 1e-3), np.full(5, np.nan), np.zeros(5, bool), 5)
    assert unsure.interval(0.95)[1] - sure.interval(0.95)[1] == pytest.approx(5e-6, rel=0.2)


def test_intervals_of_skewed_weights_cover():
    """Contributions like those of a fit that is too narrow; negative control below."""
    assert coverage(lambda d: d.interval(0.95)) >= 0.94


def test_the_plain_interval_of_skewed_weights_does_not():
    assert coverage(lambda d: d.tally.interval(0.95, 10.0)) < 0.93


def coverage(interval_of):
    rng, covered, n_seeds = np.random.default_rng(1), 0, 400
    for _ in range(n_seeds):
        w = 1e-6 * rng.random(300) ** -0.45  # mean 1e-6 / 0.55
        low, high = interval_of(draws(w))
        covered += low <= 1e-6 / 0.55 <= high
    return covered / n_seeds
