"""Which declared direction is to be looked at first."""

import numpy as np
import pytest

from crashrate.crash_set.order import RiskOrder
from crashrate.estimation.alarms import Alarm
from crashrate.estimation.suspect import Suspect, suspect

NAMES = ("a", "b", "c")


def outcomes(n=300):
    x = np.random.default_rng(0).normal(size=(n, 3))
    return x, (x.sum(axis=1) > 1).astype(float)


@pytest.mark.parametrize("wrong", NAMES)
def test_the_one_direction_that_is_wrong_is_named(wrong):
    directions = {n: "decreasing" if n == wrong else "increasing" for n in NAMES}
    x, y = outcomes()
    y[::7] = np.nan
    found = suspect(RiskOrder.from_mapping(directions, NAMES), x, y)
    assert found.coordinate == wrong
    assert (found.n_outcomes, found.n_against_reversed) == (np.isfinite(y).sum(), 0)
    assert found.n_against > 10
    assert f"direction of {wrong} first" in found.sentence()
    assert found.to_dict()["sentence"] == found.sentence()


@pytest.mark.parametrize("directions", [("increasing",) * 3, ("decreasing",) * 3])
def test_none_is_named_where_all_are_right_or_no_single_one_is_wrong(directions):
    order = RiskOrder.from_mapping(dict(zip(NAMES, directions, strict=True)), NAMES)
    assert suspect(order, *outcomes()) is None


def test_ripples_name_none():
    x = np.random.default_rng(1).normal(size=(400, 3))
    s = x.sum(axis=1)
    y = (s + 0.3 * np.sin(20 * s) > 0).astype(float)
    assert suspect(RiskOrder.from_mapping(dict.fromkeys(NAMES, "increasing"), NAMES), x, y) is None


def test_without_outcomes_there_is_none():
    order = RiskOrder.from_mapping({"a": "increasing"}, NAMES)
    assert suspect(order, np.empty((0, 3)), np.empty(0)) is None


def test_the_estimate_says_it_beside_the_alarm(cases):
    case = cases.half_plane(1e-3)
    first, *others = case.risk
    wrong = {first: "decreasing"} | dict.fromkeys(others, "increasing")
    got = case.estimate(risk=wrong, max_calls=200)
    assert {Alarm.ORDER_CONTRADICTED, Alarm.ORDER_DROPPED} & set(got.alarms)
    assert isinstance(got.order_suspect, Suspect)
    assert got.order_suspect.coordinate == first
    assert got.to_dict()["order_suspect"]["coordinate"] == first
    assert case.estimate(max_calls=200).order_suspect is None
