"""Without an order a campaign estimates once its surrogate has grown to the crash set."""

from dataclasses import replace

import numpy as np
import pytest

from crashrate.estimation import sequential, state, view
from crashrate.estimation.state import N_STEADY, State

P = 1e-6


class Labels:
    """As many outcomes as are asked for, and whether an order is in use."""

    def __init__(self, learned):
        self.n, self.learned, self.contradictions = 100, learned, 0


def state_of(*foreseen, learned=None, rounds=()):
    found = State(Labels(learned), np.empty((0, 2)), None, None, rounds=rounds)
    for probability in foreseen:
        found = found.foreseeing(probability)
    return found


def test_sums_over_the_latest_pools_must_agree():
    assert not state_of(1.0, 1.0).steady
    assert state_of(1.0, 1.04, 1.09).steady
    assert not state_of(1.0, 1.04, 1.11).steady
    assert state_of(5.0, 1.0, 1.0, 1.0).steady
    assert len(state_of(*range(9)).foreseen) == N_STEADY


def test_what_is_asked_for_without_an_order_alone_and_once():
    assert state_of(learned=True).steady
    assert state_of(1.0, 2.0, 3.0, rounds=(object(),)).steady
    assert not replace(state_of(1.0, 2.0, 3.0, rounds=(object(),)), rounds=()).steady


class FirstRoundError(Exception):
    """A campaign begins to estimate."""


def foreseen_by_first_rounds(cases, monkeypatch):
    """Shares of the probability that the pools of first rounds hold likely, one for each seed."""

    def first(*arguments):
        raise FirstRoundError(arguments[2].probability / P)

    monkeypatch.setattr(sequential, "_estimate", first)
    return [foreseen(cases, seed) for seed in range(4)]


def foreseen(cases, seed):
    with pytest.raises(FirstRoundError) as begun:
        cases.disc(P).estimate(seed, max_calls=900)
    return begun.value.args[0]


def test_first_rounds_foresee_a_disc(cases, monkeypatch):
    assert np.mean(foreseen_by_first_rounds(cases, monkeypatch)) == pytest.approx(1.0, abs=0.12)


def test_rounds_that_begin_as_soon_as_the_surrogate_is_sure_do_not(cases, monkeypatch):
    monkeypatch.setattr(state, "STEADY", np.inf)
    monkeypatch.setattr(view, "LEARN_VARIANCE_ALONE", 3.0)
    assert np.mean(foreseen_by_first_rounds(cases, monkeypatch)) < 0.85
