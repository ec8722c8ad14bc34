"""How many runs a round has: batches are grown into, and the last round is cut to size."""

import math

import numpy as np
import pytest
from scipy.special import stdtrit

from crashrate.estimation.rounds import MIN_ROUNDS, Round, combine, draws_to
from crashrate.estimation.selection import to_estimate
from crashrate.estimation.sizing import FEWEST, ROUND, last, size
from crashrate.estimation.state import State
from crashrate.estimation.strategy import Problem


def rounds_of(n, variance):
    one = Round(
        n_runs=10,
        estimate=0.02,
        lowest=0.02,
        highest=0.02,
        predicted=0.02,
        variance=variance,
        n_draws=10,
        squares=variance,
        largest=1e-3,
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
