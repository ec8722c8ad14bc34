"""Rounds are worth what is known now: also those whose surrogate was sure and wrong."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from crashrate.estimation import hindsight
from crashrate.estimation.carried import Carried
from crashrate.estimation.hindsight import MOST, N_KEPT, design, reconsider
from crashrate.estimation.rounds import Round, Sums, combine, counted, measure
from crashrate.estimation.selection import to_estimate
from crashrate.estimation.view import View
from crashrate.sampling.gaussians import Gaussians
from crashrate.sampling.pool import draw_pool

LEVEL = 2.0
TRUTH = float(norm.sf(LEVEL / np.sqrt(2)))


def right(u):
    """The probability of a crash where u_0 + u_1 ≥ LEVEL, told by a good surrogate."""
    return norm.cdf((u.sum(axis=1) - LEVEL) / 0.3)


def wrong(u):
    """Next to none in half of the crash set."""
    return np.where(u[:, 0] < u[:, 1], 1e-5, 1.0) * right(u)


@pytest.fixture
def seen(cases):
    """A fresh pool, its crashes held as `hold` says; with the true outcomes."""

    def make(hold, rng, n=2000):
        proposal = Gaussians(np.ones(1), np.full((1, 2), 0.8), 2 * np.eye(2)[None])
        pool = draw_pool(proposal, cases.standard_normal(2), lambda x: x, n, rng)
        h, none = hold(pool.u), np.zeros(n, dtype=bool)
        view = View(pool, h, h, none, none, none, none, none)
        return view, (pool.u.sum(axis=1) >= LEVEL).astype(float)

    return make


def round_of(view, outcomes, n, rng):
    drawn = to_estimate(view, n, rng)
    return replace(measure(view, drawn, outcomes[drawn.rows]), design=design(view, drawn))


def campaigns(seen, times=200):
    """Eight rounds by a wrong surrogate, three by a right one: as known then, and as known now."""
    rng = np.random.default_rng(0)
    for _ in range(times):
        holds = [wrong] * 8 + [right] * 3
        rounds = [round_of(*seen(hold, rng), 10, rng) for hold in holds]
        yield rounds, reconsider(rounds, right)


def test_intervals_hold_though_early_rounds_were_sure_and_wrong(seen, check_coverage):
    now = [combine(known, 0.95) for _, known in campaigns(seen)]
    check_coverage([(c.lower, c.upper) for c in now], TRUTH)


def test_by_what_was_known_then_they_are_seen_not_to_hold(seen, check_coverage):
    then = [combine(rounds, 0.95) for rounds, _ in campaigns(seen)]
    with pytest.raises(AssertionError, match="intervals hold"):
        check_coverage([(c.lower, c.upper) for c in then], TRUTH)


@pytest.mark.parametrize("hold", [right, lambda u: np.where(u[:, 0] < u[:, 1], 0.02, 1) * right(u)])
def test_the_variance_is_that_of_rounds_drawn_anew(seen, hold, monkeypatch):
    """By the outcomes themselves, for draws that are not kept from scattering (one at a time)."""
    monkeypatch.setattr(hindsight, "MOST", np.inf)
    rng = np.random.default_rng(1)
    predicted, errors = [], []
    for _ in range(300):
        view, outcomes = seen(hold, rng)
        ones = [round_of(view, outcomes, 1, rng) for _ in range(4)]
        known = reconsider(ones, lambda u: (u.sum(axis=1) >= LEVEL).astype(float))
        predicted += [r.variance for r in known]
        errors += [r.estimate - TRUTH for r in known]
    assert np.mean(predicted) == pytest.approx(np.mean(np.square(errors)), rel=0.25)


def test_what_is_still_held_changes_nothing(seen):
    rng = np.random.default_rng(2)
    view, outcomes = seen(right, rng)
    one = round_of(view, outcomes, 10, rng)
    (same,) = reconsider([one], right)
    assert same.known == pytest.approx(one.predicted)
    assert same.variance == pytest.approx(one.variance, rel=0.01)
    assert len(one.design.u) <= N_KEPT < len(view.h)
    # a round without a design stays as it is
    assert reconsider([replace(one, design=None)], wrong) == (replace(one, design=None),)


@pytest.mark.parametrize("now", [right, lambda u: 0.3 * right(u)])
def test_the_rows_kept_tell_what_all_of_them_would(seen, now, monkeypatch):
    """Also where far less is known to crash than was thought, or far more."""
    rng = np.random.default_rng(3)
    for then in (lambda u: np.where(u[:, 0] > 1, right(u), 1e-6), lambda u: right(u - 0.4)):
        view, _ = seen(then, rng, 8000)
        drawn = to_estimate(view, 10, rng)
        whole = design(view, drawn)
        assert len(whole.u) <= N_KEPT < len(view.h)
        some = whole.now(now(whole.u))
        monkeypatch.setattr(hindsight, "N_KEPT", 100_000)
        every = design(view, drawn)
        assert some == pytest.approx(every.now(now(every.u)), rel=0.5)
        monkeypatch.undo()


def test_a_crash_out_of_the_question_moves_by_a_few_times_the_probability_at_most(seen):
    rng = np.random.default_rng(3)
    view, outcomes = seen(lambda u: np.where(u[:, 0] > 1, right(u), 1e-12), rng)
    one = round_of(view, outcomes, 10, rng)
    (known,) = reconsider([one], right)
    added = known.known - one.predicted
    assert added > 0.3 * known.known
    assert one.variance < known.variance < 1.1 * (one.variance + MOST * known.known * added)


def test_of_next_to_nothing_left_no_round_is_certain(seen):
    rng = np.random.default_rng(5)
    one = round_of(*seen(right, rng), 10, rng)
    (known,) = reconsider([one], lambda u: 1e-9 * right(u))
    assert 0 < known.known < 1e-8 * one.predicted
    assert known.variance > 0
    # and it is left out beside rounds that hold what there is
    assert list(counted([known, one, one, one])) == [one] * 3


def test_rounds_that_foresaw_less_than_half_are_left_out():
    """Their variance, capped, would not make up for what they are all too low by."""
    one = Round(6, 1.0, 1.0, 1.0, 1.0, 1.0, 0.01, 6, 0.01, 0.1)
    blind = replace(one, predicted=0.4)
    assert list(counted([blind, one, one])) == [one, one]
    assert list(counted([blind, blind])) == [blind, blind]  # none knew better


def test_members_and_consequences_are_as_sure_as_the_event(seen):
    rng = np.random.default_rng(4)
    one = round_of(*seen(wrong, rng), 10, rng)
    sums = Sums(np.ones(2), np.ones(2), np.array([1.0, 2.0]), np.ones(2))
    carried = Carried(replace(one, design=None), 1.0, 1.0, 1.0)
    with_both = replace(one, members=sums, consequences=(carried,))
    (known,) = reconsider([with_both], right)
    by = known.variance / one.variance
    assert by > 2
    np.testing.assert_allclose(known.members.variances, by * sums.variances)
    injury = known.consequences[0].round
    assert injury.variance == pytest.approx(by * one.variance)
    assert injury.known == pytest.approx(known.known)
    # a consequence has doubts of its own: none are taken from it
    (surer,) = reconsider([with_both], lambda u: 1e-9 * right(u))
    assert surer.variance < one.variance == surer.consequences[0].round.variance
    (again,) = reconsider([known], right)
    assert again.variance == pytest.approx(known.variance)
    np.testing.assert_allclose(again.members.variances, known.members.variances)
