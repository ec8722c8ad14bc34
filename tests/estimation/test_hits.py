"""Few hits: the limit holds, says little more than it must, and keeps a campaign going."""

from dataclasses import replace

import numpy as np
import pytest

from crashrate.crash_set.order import RiskOrder
from crashrate.estimation.alarms import Alarm
from crashrate.estimation.answer import answer
from crashrate.estimation.hits import Hits, count, upper_end
from crashrate.estimation.labels import Labels
from crashrate.estimation.rounds import Round, combine, measure
from crashrate.estimation.selection import to_estimate
from crashrate.estimation.state import State
from crashrate.estimation.strategy import Problem
from crashrate.estimation.trust import ENOUGH, LOOSE, trust


@pytest.fixture
def sure_of_safety(toy_view):
    """A view in doubt where all is safe and sure of safety elsewhere, and the true outcomes."""
    rng = np.random.default_rng(0)
    view, outcomes = toy_view(rng)
    lot = rng.random(len(view.h))
    h = np.where((outcomes == 0) & (lot < 0.2), 0.5, 1e-7 * lot)
    h = np.where(view.undecided, h, view.h)
    crash = view.inner | (view.undecided & (outcomes == 1))
    return replace(view, h=h, surrogate_h=h), crash.astype(float)


def limits(view, outcomes, exaggerate=1.0, times=400, rounds=3):
    """Intervals of campaigns that expect one hit."""
    rng, found = np.random.default_rng(1), []
    for _ in range(times):
        hits = []
        for _ in range(rounds):
            drawn = to_estimate(view, 100, rng)
            one = count(view, drawn, outcomes[drawn.rows])
            hits.append(replace(one, reach=exaggerate * one.reach))
        if sum(h.n for h in hits) < ENOUGH:
            found.append((0.0, upper_end(hits, 0.95)))
        else:
            found.append((0.0, 1.0))
    return found


def test_the_limit_holds(sure_of_safety, check_coverage):
    view, outcomes = sure_of_safety
    truth = float(view.weights @ outcomes)
    check_coverage(limits(view, outcomes), truth, confidence=0.975)


def test_a_limit_from_more_draws_than_there_were_is_seen_not_to_hold(
    sure_of_safety, check_coverage
):
    view, outcomes = sure_of_safety
    truth = float(view.weights @ outcomes)
    with pytest.raises(AssertionError, match="intervals hold"):
        check_coverage(limits(view, outcomes, exaggerate=10), truth, confidence=0.975)


def test_counts_crashes_that_nothing_implied_and_each_once(toy_view):
    view, _ = toy_view(np.random.default_rng(2))
    drawn = to_estimate(view, 400, np.random.default_rng(3))
    undecided = np.unique(drawn.rows[view.undecided[drawn.rows]])
    assert len(undecided) < len(drawn.rows) < drawn.n == 400
    got = count(view, drawn, np.ones(len(drawn.rows)))
    assert (got.n, got.n_failed) == (len(undecided), 0)
    failed = count(view, drawn, np.full(len(drawn.rows), np.nan))
    assert (failed.n, failed.n_failed) == (0, len(undecided))
    assert got.taken == pytest.approx(view.weights @ view.inner)
    expected = np.minimum(400 * drawn.probabilities, 1)  # of a row: it counts once
    assert got.reach == pytest.approx((expected / view.weights)[view.undecided].min())


def test_upper_end_is_poissons():
    none = [Hits(reach=100.0, taken=0.1), Hits(reach=200.0, taken=0.2)]
    taken = (100 * 0.1 + 200 * 0.2) / 300  # whichever round saw more of it
    assert upper_end(none, 0.95) == pytest.approx(taken + 3.6889 / 300, rel=1e-4)
    one = [none[0], replace(none[1], n=1)]
    assert upper_end(one, 0.95) == pytest.approx(taken + 5.5716 / 300, rel=1e-4)
    # a failed run may have been the one that was missed
    assert upper_end([none[0], replace(none[1], n_failed=1)], 0.95) == upper_end(one, 0.95)
    ten = [none[0], replace(none[1], n=10)]
    assert upper_end(ten, 0.95) == pytest.approx(taken + 18.3904 / 300, rel=1e-4)
    assert upper_end([Hits(reach=1.0)], 0.95) == 1.0
    assert upper_end([], 0.95) == 1.0


def test_where_nothing_is_open_the_order_says_all(toy_view):
    view, outcomes = toy_view(np.random.default_rng(4))
    closed = replace(view, safe=~view.inner)
    drawn = to_estimate(closed, 10, np.random.default_rng(5))
    got = count(closed, drawn, outcomes[drawn.rows])
    assert upper_end([got], 0.95) == got.taken == pytest.approx(view.weights @ view.inner)
    # such a round tells nothing of others in which something was open
    open_ = Hits(reach=100.0, taken=0.1)
    assert upper_end([got, open_], 0.95) == upper_end([open_], 0.95)


def test_where_simulations_fail_may_be_crashes(toy_view):
    view, outcomes = toy_view(np.random.default_rng(4))
    failing = replace(view, failing=view.undecided & (view.pool.u[:, 0] > 0))
    drawn = to_estimate(failing, 10, np.random.default_rng(5))
    got = count(failing, drawn, outcomes[drawn.rows])
    more = float(view.weights @ failing.failing)
    assert more > 0
    assert got.taken == pytest.approx(view.weights @ view.inner + more)


def told(cases, view, outcomes, n):
    """What a campaign answers after three rounds of `n` draws of this view."""
    order = RiskOrder.from_mapping(cases.increasing(2), ("a", "b"))
    problem = Problem(traffic=cases.standard_normal(2), order=order, relative_half_width=1.0)
    rng = np.random.default_rng(6)
    drawn = [to_estimate(view, n, rng) for _ in range(3)]
    rounds = tuple(measure(view, d, outcomes[d.rows]) for d in drawn)
    state = State(
        Labels.empty(problem),
        np.empty((0, 2)),
        problem.traffic,
        None,
        rounds=rounds,
        learning=False,
    )
    return answer(problem, state, view), combine(rounds, 0.95)


def test_an_answer_without_hits_is_wide(cases, sure_of_safety, toy_view):
    view, outcomes = sure_of_safety
    snapshot, rounds = told(cases, view, np.where(view.inner, 1.0, 0.0), 60)
    assert snapshot.interval[0] == rounds.lower
    assert snapshot.interval[1] > 1.3 * rounds.upper
    assert Alarm.TOO_FEW_CRASHES in snapshot.alarms
    view, outcomes = toy_view(np.random.default_rng(0), 8000)
    hit, rounds = told(cases, view, outcomes, 2000)
    assert rounds.half_width < LOOSE * rounds.estimate
    assert hit.interval == (rounds.lower, rounds.upper)
    assert Alarm.UNSETTLED not in hit.alarms
    assert Alarm.TOO_FEW_CRASHES not in hit.alarms


def test_a_loose_answer_is_wider_still_however_many_hits(cases, toy_view):
    view, outcomes = toy_view(np.random.default_rng(0))
    loose, rounds = told(cases, view, outcomes, 60)
    assert rounds.half_width > LOOSE * rounds.estimate
    assert loose.interval[1] > 1.3 * rounds.upper
    assert loose.interval[1] <= view.bounds()[1]  # what the order leaves open
    assert Alarm.UNSETTLED in loose.alarms
    assert Alarm.TOO_FEW_CRASHES not in loose.alarms


@pytest.mark.parametrize(("first", "unsettled"), [(0.03, True), (0.5, False)])
def test_an_estimate_that_moved_by_a_multiple_has_not_settled(cases, first, unsettled):
    """Also where the rounds that held so little are left out of the estimate since."""
    problem = Problem(traffic=cases.standard_normal(2))
    one = Round(6, 1e-6, 1e-6, 1e-6, 1e-6, 1e-6, 1e-16, 1e-16, 1e-7, hits=Hits(n=4, reach=3e6))
    low = replace(one, predicted=first * one.predicted)
    rounds = (low, one, one, one)
    state = State(Labels.empty(problem), np.empty((0, 2)), problem.traffic, None, rounds=rounds)
    c = combine(rounds, 0.95)
    assert c.n_rounds == 3
    found = trust(problem, state, c, 1.0)
    assert not found.few
    assert found.unsettled == unsettled
    assert (found.limit > c.upper) == unsettled
