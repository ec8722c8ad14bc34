"""Without an order a campaign estimates once its surrogate has grown to the crash set."""

import numpy as np
import pytest

from crashrate.estimation import readiness, sequential, view
from crashrate.estimation.readiness import AGREEING, MOST, foreseeing, ready
from crashrate.estimation.state import State
from crashrate.estimation.strategy import Problem

P = 1e-6


class Labels:
    """As many outcomes as are asked for, and whether an order is in use."""

    def __init__(self, learned):
        self.n, self.learned, self.contradictions = 100, learned, 0


class Pool:
    """So unsure that no round would tell, or sure."""

    def __init__(self, *, unsure=False):
        self.spread, self.probability = np.array([2.0 if unsure else 1.0]), 1.0


def state_of(*foreseen, learned=None, rounds=()):
    found = State(Labels(learned), np.empty((0, 2)), None, None, rounds=rounds)
    for probability in foreseen:
        found = foreseeing(found, Pool(), probability)
    return found


@pytest.fixture
def is_ready(cases):
    def ask(state, batch_size=10):
        return ready(Problem(traffic=cases.standard_normal(2), batch_size=batch_size), state)

    return ask


def test_sums_over_the_latest_pools_must_agree(is_ready):
    assert not is_ready(state_of(1.0, 1.0, 1.0))
    assert is_ready(state_of(1.0, 1.02, 1.04, 1.09))
    assert not is_ready(state_of(1.0, 1.02, 1.04, 1.11))
    assert is_ready(state_of(5.0, 1.0, 1.0, 1.0, 1.0))


def test_of_two_pools_where_a_batch_lies_between_them(is_ready):
    assert is_ready(state_of(1.0, 1.0), batch_size=50)
    assert not is_ready(state_of(1.0, 1.2), batch_size=50)


def test_sums_that_never_agree_are_not_waited_for(is_ready):
    growing = [2.0**k for k in range(MOST + 2)]
    assert not is_ready(state_of(*growing[: MOST - 1]))
    assert is_ready(state_of(*growing))
    assert len(state_of(*growing).foreseen) == MOST


def test_a_pool_where_no_round_would_tell_begins_anew(is_ready):
    state = state_of(*[1.0] * AGREEING)
    assert is_ready(state)
    assert not is_ready(foreseeing(state, Pool(unsure=True), 1.0))


def test_with_an_order_or_rounds_one_pool_is_enough(is_ready):
    assert is_ready(state_of(1.0, learned=True))
    assert not is_ready(state_of(learned=True))
    assert is_ready(state_of(1.0, rounds=(object(),)))


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
    monkeypatch.setattr(readiness, "AGREEING", 1)
    monkeypatch.setattr(view, "LEARN_VARIANCE_ALONE", 3.0)
    assert np.mean(foreseen_by_first_rounds(cases, monkeypatch)) < 0.85
