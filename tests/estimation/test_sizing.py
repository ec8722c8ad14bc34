"""How many runs a round has: batches are grown into, and the last round is cut to size."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import stdtrit

from crashrate.estimation.encounters import Encounters
from crashrate.estimation.hits import Hits
from crashrate.estimation.rounds import MIN_ROUNDS, Round, combine, draws_to
from crashrate.estimation.selection import to_estimate
from crashrate.estimation.sizing import (
    AUDIT_EVERY,
    AUDITED_ROUNDS,
    FEWEST,
    ROUND,
    audits_due,
    last,
    size,
    size_to_learn,
)
from crashrate.estimation.state import State
from crashrate.estimation.strategy import Problem


def rounds_of(n, variance):
    one = Round(
        n_runs=10,
        estimate=0.02,
        lowest=0.02,
        highest=0.02,
        predicted=0.02,
        known=0.02,
        variance=variance,
        squares=variance,
        largest=1e-3,
        hits=Hits(n=2, reach=1e4),
    )
    return (one,) * n


class Labels:
    """As many runs as are asked for."""

    def __init__(self, n):
        self.n, self.learned, self.contradictions = n, True, 0


def state_of(n_labels, rounds=()):
    return State(Labels(n_labels), np.empty((0, 2)), None, None, rounds=rounds)


@pytest.fixture
def problem(cases):
    def make(**options):
        return Problem(traffic=cases.standard_normal(2), **options)

    return make


@pytest.mark.parametrize(
    ("batch_size", "n", "expected"),
    [(10, 40, 10), (1000, 15, ROUND), (1000, 60, 30), (50, 400, 50), (3, 400, ROUND)],
)
def test_large_batches_are_grown_into(problem, batch_size, n, expected):
    assert size(problem(batch_size=batch_size), state_of(n)) == expected


@pytest.mark.parametrize(("batch_size", "expected"), [(1, 5), (10, 5), (50, 50)])
def test_a_round_of_ten_that_learns_has_half_the_runs(problem, batch_size, expected):
    assert size_to_learn(problem(batch_size=batch_size), state_of(400)) == expected


def test_a_round_that_learns_of_members_is_whole(problem):
    assert size_to_learn(problem(), replace(state_of(400), members=(1,))) == ROUND


def audits_of(problem, sizes, *, begun_at=23, shift=0):
    """Audits due in rounds of these sizes, one after another."""
    starts = begun_at + np.cumsum([0, *sizes[:-1]])
    states = [replace(state_of(int(n)), begun_at=begun_at) for n in starts]
    return [audits_due(problem, s, n, shift) for s, n in zip(states, sizes, strict=True)]


def test_audits_of_two_kinds_come_by_turns(problem):
    among, far = (audits_of(problem(), [5] * 40, shift=shift) for shift in (0, AUDIT_EVERY // 2))
    assert among[:24] == [0, 1] * 12
    assert far[:24] == [1, 0] * 12
    assert sum(among[24:] + far[24:]) == 0


@pytest.mark.parametrize("round_size", [5, 7, 10, 30])
def test_as_many_runs_audit_whatever_the_rounds(problem, round_size):
    sizes = [round_size] * (300 // round_size)
    assert sum(audits_of(problem(), sizes)) == AUDITED_ROUNDS
    assert sum(audits_of(problem(), sizes, shift=AUDIT_EVERY // 2)) == AUDITED_ROUNDS


def test_large_batches_are_audited_for_as_many_rounds(problem):
    sizes = [100] * 20
    audits = audits_of(problem(batch_size=100), sizes, begun_at=300)
    assert audits == [10] * AUDITED_ROUNDS + [0] * 8


def test_without_an_order_nothing_audits_it(problem):
    state = state_of(40)
    state.labels.learned = None
    assert audits_due(problem(), state, 100) == 0


def test_small_batches_are_put_together_to_rounds(cases):
    """The same campaign as in tens, asked for three at a time."""
    case = cases.half_plane(1e-6)
    found = [case.estimate(batch_size=n, relative_half_width=0.3) for n in (3, 10)]
    assert found[0].n_calls == found[1].n_calls
    assert found[0].interval == found[1].interval
    campaign = case.campaign(batch_size=3)
    while not campaign.done:
        x = campaign.ask()
        assert len(x) <= 3
        campaign.tell(case.crash(x))


def test_as_many_draws_as_the_target_asks_for():
    per_draw, of_pool = 4e-5, 1e-7
    so_far = combine(rounds_of(4, 4e-5), 0.95)
    wide, tight = (draws_to(t, so_far, per_draw, of_pool, 0.95) for t in (0.3, 0.2))
    assert 0 < wide < tight < math.inf
    # with them the predicted interval has the width that is aimed at, and not with half of them
    for n, met in ((tight, True), (tight / 2, False)):
        variance = so_far.inflation * (per_draw / n + of_pool)
        precision = 1 / so_far.standard_error**2 + 1 / variance
        half_width = stdtrit(so_far.freedom + 1, 0.975) / math.sqrt(precision)
        assert (half_width <= 0.2 * so_far.estimate) == met
    assert (
        draws_to(1e-4, so_far, per_draw, of_pool, 0.95) == math.inf
    )  # the pool itself varies more


def test_a_round_is_the_last_only_after_two_others_and_where_a_batch_suffices(problem, toy_view):
    view, _ = toy_view(np.random.default_rng(0))
    near = rounds_of(MIN_ROUNDS - 1, 1e-9)
    assert last(problem(), state_of(100, near[:1]), view) is None
    assert last(problem(), state_of(100, near), view) == FEWEST
    assert last(problem(relative_half_width=1e-6), state_of(100, near), view) is None


def test_no_round_is_the_last_while_something_else_keeps_the_interval_wide(problem, toy_view):
    view, _ = toy_view(np.random.default_rng(0))
    near = rounds_of(MIN_ROUNDS, 1e-9)
    state = state_of(100, near)
    assert last(problem(), state, view) == FEWEST
    unhit = tuple(replace(r, hits=Hits(reach=10.0)) for r in near)
    assert last(problem(), replace(state, rounds=unhit), view) is None
    crashed = replace(state, encounters=Encounters(n=30, n_crashes=20))
    assert last(problem(), crashed, view) is None


def test_a_campaign_asks_for_no_more_than_it_needs(cases):
    campaign = cases.half_plane(1e-6).campaign(batch_size=100)
    sizes, crash = [], cases.half_plane(1e-6).crash
    while not campaign.done:
        sizes.append(len(x := campaign.ask()))
        campaign.tell(crash(x))
    assert sizes[-1] < max(sizes)
    assert campaign.estimate().relative_half_width <= 0.1


def test_few_draws_are_as_unbiased_as_many(toy_view, check_mean):
    from crashrate.estimation.rounds import measure

    found = []
    for seed in range(400):
        rng = np.random.default_rng(seed)
        view, outcomes = toy_view(rng)
        drawn = to_estimate(view, FEWEST, rng)
        truth = float(view.weights @ outcomes)
        found.append(measure(view, drawn, outcomes[drawn.rows]).estimate / truth)
    check_mean(found, 1.0)
