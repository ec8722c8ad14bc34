"""Exact bounds where they can be had; bounds from draws, and no traceback, where not."""

import numpy as np
import pytest
from scipy.stats import norm

from crashrate.crash_set.order import RiskOrder
from crashrate.errors import NumericalError
from crashrate.estimation import exact_bounds as module
from crashrate.estimation import sequential
from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.estimation.exact_bounds import exact_bounds, within
from crashrate.estimation.labels import Labels
from crashrate.estimation.strategy import Problem, Snapshot


def told(cases, d=2):
    order = RiskOrder.from_mapping(cases.increasing(d), tuple("abcdef"[:d]))
    problem = Problem(traffic=cases.standard_normal(d), order=order)
    x = np.stack([np.full(d, 2.0), np.full(d, -1.0)])
    return problem, Labels.empty(problem).add(x, np.array([1.0, 0.0]))


def test_are_exact(cases):
    problem, labels = told(cases)
    got = exact_bounds(problem, labels)
    assert got == pytest.approx((norm.sf(2) ** 2, 1 - norm.cdf(-1) ** 2), rel=1e-9)
    assert exact_bounds(problem, Labels.empty(problem).without_order()) == (0.0, 1.0)
    assert exact_bounds(*told(cases, d=4)) is None


def unsettled(*_):
    raise NumericalError("box probability: 1 of 807 integrals had not settled")


def test_a_box_that_does_not_settle_leaves_bounds_from_draws(cases, monkeypatch, small):  # noqa: ARG001
    case = cases.half_plane(1e-3)
    options = {"relative_half_width": 0.2, "max_calls": 300}
    exact = case.estimate(**options)
    monkeypatch.setattr(module, "probability_bounds", unsettled)
    assert exact_bounds(*told(cases)) is None
    drawn = case.estimate(**options)
    assert drawn.interval == exact.interval
    assert drawn.bounds == pytest.approx(exact.bounds, rel=0.6)
    assert drawn.bounds != exact.bounds
    assert drawn.bounds[0] <= case.probability <= drawn.bounds[1]


@pytest.mark.parametrize(
    ("probability", "interval", "expected"),
    [
        (2.0, (1.8, 2.2), (2.0, (1.8, 2.2))),  # inside: as it is
        (1.8, (1.7, 1.95), (1.9, (1.7, 1.95))),  # beside, the interval reaches in
        (1.8, (1.7, 1.85), (1.9, (1.7, 2.1))),  # the interval lies beside too: as wide as both
        (2.3, (2.05, 2.5), (2.1, (2.05, 2.5))),
        (2.3, (2.2, 2.5), (2.1, (1.9, 2.5))),
    ],
)
def test_an_estimate_beside_them_is_moved_in_and_no_interval_shrinks(
    probability, interval, expected
):
    told = within(Snapshot(probability=probability, interval=interval), (1.9, 2.1))
    assert (told.probability, told.interval) == expected


def test_no_estimate_is_moved_nowhere():
    told = within(Snapshot(), (1.9, 2.1))
    assert np.isnan(told.probability)
    assert told.interval == (0.0, 1.0)


def test_an_interval_that_they_widen_beyond_the_target_ends_no_campaign(cases, monkeypatch, small):  # noqa: ARG001
    case, options = cases.half_plane(1e-3), {"relative_half_width": 0.2, "max_calls": 120}
    plain = case.estimate(**options)
    assert plain.stop_reason is StopReason.TARGET_MET
    beside = (0.5 * plain.interval[0], 0.6 * plain.interval[0])
    monkeypatch.setattr(sequential, "exact_bounds", lambda *_: beside)
    got = case.estimate(**options)
    assert (got.stop_reason, got.n_calls) == (StopReason.BUDGET_ENDED, 120)
    assert Alarm.TARGET_NOT_REACHED in got.alarms
    assert got.interval[0] == beside[0]
    assert got.interval[1] > case.probability


def test_in_one_variable_estimates_lie_within_their_bounds(cases):
    """They are so close that draws fall beside them."""
    for seed in range(5):
        study = cases.tail(1e-6).estimate(seed=seed, relative_half_width=0.2)
        assert study.bounds[0] <= study.probability <= study.bounds[1]
        assert study.interval[0] <= 1e-6 <= study.interval[1]
