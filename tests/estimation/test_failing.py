"""Regions in which a simulator fails."""

import numpy as np

from crashrate.estimation.failing import fails


def test_a_region_of_failures_and_not_a_failure_here_and_there():
    u = np.random.default_rng(0).standard_normal((400, 2))
    at = np.random.default_rng(1).standard_normal((2000, 2))
    aside = u[:, 0] > 1.0
    found = fails(u[~aside], u[aside], at)
    deep, clear = at[:, 0] > 1.3, at[:, 0] < 0.7
    assert found[deep].mean() > 0.9
    assert not found[clear].any()
    by_lot = np.random.default_rng(2).random(400) < aside.mean()
    assert fails(u[~by_lot], u[by_lot], at).mean() < 0.05


def test_without_failures_or_with_too_few_nothing_fails():
    u, at = np.zeros((5, 2)), np.ones((3, 2))
    assert not fails(u, u[:0], at).any()
    assert not fails(u, at[:1], at).any()


def test_where_every_run_failed_everything_fails():
    u = np.random.default_rng(3).standard_normal((20, 2))
    assert fails(u[:0], u, u[:4]).all()
