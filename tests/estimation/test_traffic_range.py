"""One set of runs, the probability under every member of the traffic model: exact answers."""

import math

import numpy as np
import pytest
from scipy.stats import norm

from crashrate.estimation.alarms import Alarm
from crashrate.estimation.campaign import Campaign
from crashrate.estimation.run import estimate
from crashrate.estimation.traffic_range import TrafficRange
from crashrate.traffic.model import TrafficModel

LEVEL = 4.0
SHIFTS = (-0.3, 0.0, 0.2, 0.4)
EXACT = norm.sf(LEVEL - np.array(SHIFTS))


def member(shift, scales=None):
    mean = np.full((1, 2), shift / math.sqrt(2))
    lower = [0.0, -np.inf] if scales else [-np.inf] * 2
    return TrafficModel(
        [1.0], mean, np.eye(2)[None], lower, [np.inf] * 2, ["a", "b"], scales=scales
    )


def family(scales=None, shifts=SHIFTS):
    members = [member(shift, scales) for shift in shifts]
    first = members[0]
    return TrafficModel(
        first.weights, first.means, first.covariances, first.lower, first.upper, ["a", "b"],
        scales=scales, members=members,
    )  # fmt: skip


def crash(x):
    return x.sum(axis=1) / math.sqrt(2) > LEVEL


def crash_of_logarithm(x):
    return crash(np.column_stack([np.log(x[:, 0]), x[:, 1]]))


def found(seed, scales=None, shifts=SHIFTS, **options):
    risk = {"a": "increasing", "b": "increasing"}
    simulate = crash if scales is None else crash_of_logarithm
    return estimate(simulate, family(scales, shifts), risk=risk, seed=seed, **options)


@pytest.fixture(scope="module")
def studies():
    return [found(seed, relative_half_width=0.15) for seed in range(12)]


def test_every_member_is_estimated_without_bias(studies, check_mean):
    for k, truth in enumerate(EXACT):
        check_mean([s.traffic_range.probabilities[k] for s in studies], truth)


def test_standard_errors_of_members_are_honest(studies):
    z = np.array(
        [(np.array(s.traffic_range.probabilities) - EXACT) / s.traffic_range.standard_errors
         for s in studies]
    )  # fmt: skip
    assert np.mean(np.abs(z) < 2.5) > 0.9
    wrong = np.array([(np.array(s.traffic_range.probabilities) - EXACT[::-1])
                      / s.traffic_range.standard_errors for s in studies])  # fmt: skip
    assert np.mean(np.abs(wrong) < 2.5) < 0.5  # the check can fail


def test_the_headline_is_the_mean_of_the_members(studies, check_coverage):
    for s in studies:
        # nearly: each member has its own shares of the rounds, and rounds that it leaves out
        assert s.probability == pytest.approx(np.mean(s.traffic_range.probabilities), rel=0.03)
    check_coverage([s.interval for s in studies], EXACT.mean())


def test_on_a_log_scale_too():
    got = found(1, ("log", "linear"), relative_half_width=0.2).traffic_range
    assert np.abs(np.array(got.probabilities) / EXACT - 1).max() < 0.5


def test_without_members_there_is_no_range():
    got = estimate(crash, member(0.0), risk={"a": "increasing"}, seed=0, max_calls=60)
    assert got.traffic_range is None
    assert got.to_dict()["traffic_range"] is None


def test_quantiles_and_spread():
    p = np.exp(np.linspace(-1, 1, 21)) * 1e-6
    got = TrafficRange(tuple(p), tuple(0.1 * p))
    assert got.quantiles == pytest.approx(np.quantile(p, [0.05, 0.5, 0.95]))
    assert got.log_deviation == pytest.approx(np.log(p).std(ddof=1))
    assert not got.undetermined
    assert "do not determine" not in got.sentence()
    wide = TrafficRange(tuple(p**2 * 1e6), tuple(0.1 * p**2 * 1e6))
    assert wide.undetermined
    assert wide.sentence().startswith(
        "traffic models: the recordings do not determine this probability better than a factor 6 "
        "either way: 21 fits to the recordings give "
    )


def test_members_that_the_runs_do_not_determine_are_counted():
    got = TrafficRange((1e-6, 2e-6, -1e-8), (1e-7, 1e-7, 1e-7))
    assert got.n_undetermined == 1
    assert "1 of them is not determined by the runs" in got.sentence()
    assert got.quantiles[0] >= 0.0
    assert got.to_dict()["determined"] == [True, True, False]
    none = TrafficRange((1e-6, 1e-6), (1e-6, 1e-6))
    assert math.isnan(none.quantiles[1])
    assert "too few of them determined" in none.sentence()


@pytest.mark.parametrize(
    ("shifts", "alarms"),
    [
        ((0.0, 0.05), set()),
        ((-0.3, 0.4), {Alarm.TRAFFIC_UNDETERMINED}),
        ((0.0, -6.0), {Alarm.MEMBERS_UNDETERMINED, Alarm.TRAFFIC_UNDETERMINED}),
    ],
)
def test_alarms_of_the_range(shifts, alarms):
    got = found(0, shifts=shifts)
    both = {Alarm.MEMBERS_UNDETERMINED, Alarm.TRAFFIC_UNDETERMINED}
    assert both & set(got.alarms) == alarms


def test_members_far_below_the_others_count_as_spread():
    high, low = (1e-5, 1.1e-5, 0.9e-5), (1e-9, 2e-9, 0.0)
    got = TrafficRange(high + low, (1e-6,) * 3 + (2e-8,) * 3)
    assert got.n_undetermined == 3
    assert got.undetermined
    assert TrafficRange((1e-6, 0.0), (1e-6, 1e-6)).undetermined  # nothing is known


def test_the_factor_is_that_of_the_members_that_say_something():
    """A member that the runs put at 0 is no probability of 0, and no end of the range."""
    wide = (1e-8, 1e-7, 2e-7, 1e-6, 1e-5)
    got = TrafficRange((*wide, -1e-9, -1e-9), (*(0.1 * p for p in wide), 1e-6, 1e-6))
    assert got.quantiles[0] == 0
    assert "give not determined … 1.0e-07 … 7.3e-06 (5, 50, 95 %)" in got.sentence()
    assert "better than a factor 73 either way" in got.sentence()
    # one far above the others is left out of the spread, and is an end of the range
    above = (1e-5, 8e-6, 1e-5)
    got = TrafficRange((1e-7, 1.2e-7, 8e-7, 9e-7, *above), (1e-8, 1e-8, 1e-8, 1e-8, *above))
    assert "better than a factor 11 either way" in got.sentence()


def test_bounds_say_that_they_are_of_the_members_average():
    risk = {"a": "increasing", "b": "increasing"}
    with pytest.warns(UserWarning, match="'bounds' answers for the average of the .* 4 members"):
        Campaign(family(None), risk=risk, goal="bounds")


@pytest.mark.parametrize("method", ["huang2017", "crude", "cross-entropy"])
@pytest.mark.parametrize("scales", [None, ("log", "linear")])
def test_methods_that_do_not_tell_members_apart_answer_for_the_best_fit(scales, method):
    risk = {"a": "increasing", "b": "increasing"}
    with pytest.warns(UserWarning, match=f"'{method}' answers for the best fit alone: the 3 furth"):
        campaign = Campaign(family(scales), risk=risk, method=method)
    alone = Campaign(member(SHIFTS[0], scales), risk=risk, method=method)
    assert campaign.problem == alone.problem
    assert campaign.problem.ensemble is None
    assert campaign.ask() == pytest.approx(alone.ask())
    assert campaign.estimate().traffic_range is None
