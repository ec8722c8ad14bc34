"""A crash where the order holds that none can be is looked at more closely."""

from dataclasses import replace

import numpy as np
import pytest

from crashrate.crash_set.order import RiskOrder
from crashrate.estimation.alarms import Alarm
from crashrate.estimation.following import N_BESIDE, STEPS, follow, odd
from crashrate.estimation.labels import Labels
from crashrate.estimation.strategy import Problem, Snapshot
from crashrate.traffic.model import TrafficModel

SCALE = np.ones(2)
SAFE = [[2.0, 2.0], [2.2, 1.8], [1.8, 2.2], [2.1, 2.1]]


def problem_of(traffic):
    order = RiskOrder.from_mapping(dict.fromkeys(traffic.names, "increasing"), traffic.names)
    return Problem(traffic=traffic, order=order)


@pytest.fixture
def problem(cases):
    return problem_of(cases.standard_normal(2))


def labels_of(problem, crash, safe):
    x = np.array([*safe, crash])
    return Labels.empty(problem).add(x, np.array([0.0] * len(safe) + [1.0]))


@pytest.mark.parametrize(
    ("crash", "safe", "is_odd"),
    [
        ([0.0, 0.0], SAFE, True),
        ([0.0, 0.0], SAFE[:2], False),  # it may be they that are wrong
        ([1.7, 1.7], SAFE, False),  # no deeper than ripples are
        ([3.0, 3.0], SAFE, False),  # nothing contradicts it
    ],
)
def test_a_crash_deep_in_what_many_imply_to_be_safe_is_odd(problem, crash, safe, is_odd):
    labels = labels_of(problem, crash, safe)
    assert odd(labels, SCALE).tolist() == [len(safe)] * is_odd
    assert odd(labels.without_order(), SCALE).tolist() == []


def followed(problem, crashes):
    """What `follow` asks for, of a simulator `crashes`, and the labels it ends with."""
    d = problem.traffic.n_variables
    labels = labels_of(problem, [0.0] * d, [[a] * d for a, _ in SAFE])
    rng, told = np.random.default_rng(0), Snapshot()
    asking = follow(problem, labels, len(SAFE), np.ones(d), rng=rng, snapshot=told)
    asked, outcomes = [], None
    while True:
        try:
            x = asking.send(outcomes).x
        except StopIteration as end:
            return asked, end.value
        asked.append(x)
        outcomes = crashes(x).astype(float)


def test_more_is_asked_the_farther_the_crashes_go(problem):
    alone, labels = followed(problem, lambda x: np.zeros(len(x), bool))
    assert [len(x) for x in alone] == [N_BESIDE]
    assert labels.n == len(SAFE) + 1 + N_BESIDE
    region, labels = followed(problem, lambda x: np.ones(len(x), bool))
    assert [len(x) for x in region] == [N_BESIDE] * len(STEPS)
    away = [np.linalg.norm(x, axis=1).mean() for x in region]
    assert away == sorted(away)
    assert odd(labels, SCALE).size > 3


def test_what_is_asked_lies_in_the_box():
    law = TrafficModel(
        [1.0], np.zeros((1, 2)), np.eye(2)[None], [0.0] * 2, [np.inf] * 2, ("a", "b")
    )
    for x in followed(problem_of(law), lambda x: np.ones(len(x), bool))[0]:
        assert (x >= 0).all()


@pytest.mark.parametrize("seed", range(2))
def test_a_freak_does_not_cost_the_order(cases, seed):
    """Of all runs after the thirtieth the first far from the edge is told wrongly."""
    case, done, told = cases.half_plane(1e-6), 0, []

    def crash(x):
        nonlocal done
        y, far = case.crash(x), np.flatnonzero(x.sum(axis=1) < 4)
        if done > 30 and not told and len(far):
            told.append(x[far[0]])
            y[far[0]] = True
        done += len(x)
        return y

    got = replace(case, crash=crash).estimate(seed, max_calls=120)
    assert told
    assert Alarm.ORDER_CONTRADICTED in got.alarms
    assert Alarm.ORDER_DROPPED not in got.alarms
    assert got.interval[0] <= 1e-6 <= got.interval[1]
