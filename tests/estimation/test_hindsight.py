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
from crashrate.sampling.pool import Blend, draw_pool

LEVEL = 2.0
TRUTH = float(norm.sf(LEVEL / np.sqrt(2)))


def right(u):
    """The probability of a crash where u_0 + u_1 ≥ LEVEL, told by a good surrogate."""
    return norm.cdf((u.sum(axis=1) - LEVEL) / 0.3)


def wrong(u):
    """Next to none in a fifth of the crash set."""
    return np.where(u[:, 0] < u[:, 1] - 1.3, 1e-5, 1.0) * right(u)


@pytest.fixture
def seen(cases):
    """A fresh pool, its crashes held as `hold` says; with the true outcomes."""

    def make(hold, rng, n=2000):
        proposal = Gaussians(np.ones(1), np.full((1, 2), 0.8), 2 * np.eye(2)[None])
        pool = draw_pool(proposal, cases.standard_normal(2), lambda x: x, n, rng)
        h, none = hold(pool.u), np.zeros(n, dtype=bool)
        view = View(pool, h, h, none, none, none, none, none, ordered=True)
        return view, (pool.u.sum(axis=1) >= LEVEL).astype(float)

    return make


def round_of(view, outcomes, n, rng):
    drawn = to_estimate(view, n, rng)
    return replace(measure(view, drawn, outcomes[drawn.rows]), design=design(view, drawn))


def campaigns(seen, times=200):
    """Sixteen rounds by a wrong surrogate, three by a right one: as known then, and now."""
    rng = np.random.default_rng(0)
    for _ in range(times):
        holds = [wrong] * 16 + [right] * 3
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


def test_rounds_that_foresaw_too_little_are_left_out():
    """Their variance, capped, would not make up for what they are all too low by."""
    one = Round(6, 1.0, 1.0, 1.0, 1.0, 1.0, 0.01, 0.01, 0.1)
    blind, short = replace(one, predicted=0.7), replace(one, predicted=0.8)
    assert list(counted([blind, short, one, one])) == [short, one, one]
    assert list(counted([blind, blind])) == [blind, blind]  # none knew better


def test_members_and_consequences_are_no_surer_than_the_event(seen):
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
    # they have doubts of their own: none are taken from them
    (surer,) = reconsider([with_both], lambda u: 1e-9 * right(u))
    assert surer.variance < one.variance == surer.consequences[0].round.variance
    np.testing.assert_allclose(surer.members.variances, sums.variances)
    (again,) = reconsider([known], right)
    assert again.variance == pytest.approx(known.variance)
    np.testing.assert_allclose(again.members.variances, known.members.variances)


RARE = float(np.sqrt(2) * norm.isf(1e-7))


def steep(u):
    return np.clip(norm.cdf((u.sum(axis=1) - RARE) / 0.3), 1e-20, 1 - 1e-9)


def rare(cases, rng, blind, n=4000):
    """A pool of a rare event, held to be out of the question where u_0 < u_1 + `blind`."""
    center = Gaussians(np.ones(1), np.full((1, 2), RARE / 2 + 0.1), np.eye(2)[None])
    proposal = Blend((0.8, 0.2), (center, cases.standard_normal(2)))
    pool = draw_pool(proposal, cases.standard_normal(2), lambda x: x, n, rng)
    h, none = steep(pool.u), np.zeros(n, dtype=bool)
    h = np.where(pool.u[:, 0] < pool.u[:, 1] + blind, 1e-6 * h, h)
    return View(pool, h, h, none, none, none, none, none, ordered=True), (
        pool.u.sum(1) >= RARE
    ).astype(float)


@pytest.mark.parametrize(
    ("blind", "n_wrong", "n_right"), [(-0.5, 10, 4), (0.0, 10, 8), (0.5, 20, 8)]
)  # of a probability of 1e-7 so many rounds foresaw two thirds, half and a third
def test_intervals_hold_however_many_rounds_were_wrong(
    cases, check_coverage, blind, n_wrong, n_right
):
    rng = np.random.default_rng(7)
    truth = float(norm.sf(RARE / np.sqrt(2)))
    found = []
    for _ in range(60):
        holds = [blind] * n_wrong + [-np.inf] * n_right
        rounds = [round_of(*rare(cases, rng, shift), 6, rng) for shift in holds]
        found.append(combine(reconsider(rounds, steep), 0.95))
    check_coverage([(c.lower, c.upper) for c in found], truth)
    bias = np.mean([c.estimate for c in found]) / truth - 1
    error = np.std([c.estimate for c in found]) / truth / np.sqrt(len(found))
    assert abs(bias) < 0.03 + 2.5 * error


def test_a_round_in_which_all_is_settled_stays_as_it_is(seen):
    rng = np.random.default_rng(8)
    view, outcomes = seen(right, rng)
    drawn = to_estimate(view, 10, rng)
    settled = replace(view, h=outcomes)
    one = replace(measure(view, drawn, outcomes[drawn.rows]), design=design(settled, drawn))
    assert len(one.design.u) == 0
    (known,) = reconsider([one], right)
    assert known.known == pytest.approx(settled.probability * one.predicted / one.predicted)
    assert known.variance > 0
