"""An order is given up where outcomes contradict it deeply, in units that stay as they are."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from crashrate.crash_set.order import RiskOrder
from crashrate.estimation.following import look_closer
from crashrate.estimation.kernels import SOFT, Model
from crashrate.estimation.labels import Labels
from crashrate.estimation.refutation import MAX_DISCARDED, Verdict, verdict
from crashrate.estimation.sequential import _distrust
from crashrate.estimation.state import State
from crashrate.estimation.strategy import Problem, Snapshot
from crashrate.estimation.view import Standardiser

N_PAIRS = MAX_DISCARDED + 2
DEPTH = 0.4
WIDE = Standardiser(np.zeros(2), np.ones(2), np.full(2, 10.0))
NARROW = replace(WIDE, unit=np.ones(2))


@pytest.fixture
def problem(cases):
    case = cases.half_plane(1e-3)
    return Problem(
        traffic=case.traffic, order=RiskOrder.from_mapping(case.risk, case.traffic.names)
    )


@pytest.fixture
def rippled(problem):
    """Along an edge, crashes that safe outcomes `DEPTH` more dangerous contradict, pair by pair."""
    along = 2.0 * np.arange(N_PAIRS)
    crash = np.stack([along, -along], axis=1)
    x = np.concatenate([crash, crash + DEPTH])
    return Labels.empty(problem).add(x, np.repeat([1.0, 0.0], N_PAIRS))


def state_of(labels, standardise):
    return State(labels, labels.u[:0], None, Model(standardise))


@pytest.mark.parametrize(
    ("depths_a_unit", "expected"),
    [(0.02, Verdict.STANDS), (0.1, Verdict.ROUGH), (0.4, Verdict.FALSE)],
)
def test_the_deeper_the_contradictions_the_less_stands(rippled, depths_a_unit, expected):
    unit = np.full(2, DEPTH / depths_a_unit)
    assert verdict(rippled, unit) is expected
    assert verdict(rippled.without_order(), unit) is Verdict.STANDS


def test_the_order_falls_by_the_unit_not_by_the_surrogates_scale(problem, rippled):
    stands, falls = (_distrust(problem, state_of(rippled, s), None) for s in (WIDE, NARROW))
    assert stands.ordered
    assert not falls.ordered
    assert falls.dropped_at == rippled.n


def test_soft_kernels_join_by_the_unit(rippled):
    for standardise, join in ((WIDE, False), (NARROW, True)):
        candidates = Model(standardise)._candidates(rippled, directed=True)
        assert (SOFT[0] in candidates) is join


def test_odd_crashes_are_followed_by_the_unit(problem):
    around = [[2.0, 2.0], [2.2, 1.8], [1.8, 2.2], [2.1, 2.1]]
    labels = Labels.empty(problem).add(np.array([*around, [0.0, 0.0]]), np.array([0.0] * 4 + [1.0]))
    view = SimpleNamespace(pool=SimpleNamespace(x=labels.x), breadth=np.full(5, 0.2))
    for standardise, asked in ((WIDE, 0), (NARROW, 1)):
        state = state_of(labels, standardise)
        steps = look_closer(problem, state, view, Snapshot(), np.random.default_rng(0))
        assert len([next(steps)] if asked else list(steps)) == asked
