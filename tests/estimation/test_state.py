"""What a campaign that has an order may take for granted, and one without may not."""

from dataclasses import replace

import numpy as np
import pytest

from crashrate.crash_set.order import RiskOrder
from crashrate.estimation.kernels import Model
from crashrate.estimation.labels import Labels
from crashrate.estimation.rounds import MIN_INFLATION
from crashrate.estimation.state import State
from crashrate.estimation.strategy import Problem
from crashrate.estimation.view import Standardiser


def state_of(case):
    order = RiskOrder.from_mapping(case.risk, case.traffic.names)
    labels = Labels.empty(Problem(traffic=case.traffic, order=order))
    labels = labels.add(np.array([[1.0, 1.0], [0.0, 0.0]]), np.array([1, 0]))
    model = Model(Standardiser(np.zeros(2), np.ones(2), np.ones(2)))
    return State(labels, np.empty((0, 2)), case.traffic, model)


def test_what_is_neglected_follows_the_target(cases):
    state = state_of(cases.half_plane(0.2))
    assert state.neglected(0.1) == pytest.approx(0.005)
    assert state.neglected(0.02) == pytest.approx(0.001)
    assert state.least_inflation == MIN_INFLATION


def test_nothing_is_neglected_or_narrowed_without_an_order(cases):
    state = state_of(cases.half_plane(0.2))
    state = replace(state, labels=state.labels.without_order())
    assert state.neglected(0.1) == 0.0
    assert state.least_inflation == 1.0
