"""Exact bounds where they can be had; bounds from draws, and no traceback, where not."""

import numpy as np
import pytest
from scipy.stats import norm

from crashrate.crash_set.order import RiskOrder
from crashrate.errors import NumericalError
from crashrate.estimation import exact_bounds as module
from crashrate.estimation.exact_bounds import exact_bounds
from crashrate.estimation.labels import Labels
from crashrate.estimation.strategy import Problem


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
