"""Crash regions far from the first one found are looked for where no order speaks, and found."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

from crashrate.estimation import aiming, exploration, last_look, sequential, surveying
from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.estimation.campaign import Campaign
from crashrate.estimation.probing import farthest_as_scaled
from crashrate.estimation.run import estimate
from crashrate.estimation.strategy import Problem
from crashrate.estimation.view import see
from crashrate.sampling.gaussians import Gaussians
from crashrate.sampling.pool import Blend

LEVEL = norm.isf(5e-4)
N_OUTSIDE = surveying.N_ALIKE + surveying.N_BESIDE + surveying.N_DENSER


def two_sides(x, level=LEVEL):
    return np.abs(x[:, 0]) > level


P = 1e-3


def found(cases, seed, crash=two_sides, **options):
    options = {"max_calls": 400, "relative_half_width": 0.25} | options
    return estimate(crash, cases.standard_normal(2), seed=seed, **options)


def test_both_sides_are_found(cases, check_coverage):
    studies = [found(cases, seed) for seed in range(8)]
    check_coverage([s.interval for s in studies], P)
    assert all(s.stop_reason is StopReason.TARGET_MET for s in studies)
    assert np.mean([s.probability for s in studies]) == pytest.approx(P, rel=0.12)


def test_without_surveys_one_side_is_lost(cases, monkeypatch):
    for name in ("N_FIRST", "N_DENSER_FIRST", "N_ALIKE", "N_BESIDE", "N_DENSER"):
        monkeypatch.setattr(surveying, name, 0)
    monkeypatch.setattr(exploration, "MESH", 0)
    ratios = [found(cases, seed).probability / P for seed in range(4)]
    assert min(ratios) < 0.7


def test_a_surprise_voids_what_was_estimated_and_a_clean_look_ends_it(cases, monkeypatch):
    """The first survey left out: the look at the end has to find the other side."""
    monkeypatch.setattr(surveying, "N_FIRST", 0)
    monkeypatch.setattr(surveying, "N_DENSER_FIRST", 0)
    monkeypatch.setattr(exploration, "MESH", 0)
    looks = []
    look = surveying.survey

    def watched(*arguments):
        found = yield from look(*arguments)
        looks.append(found.surprised)
        return found

    monkeypatch.setattr(last_look, "survey", watched)
    ratios = []
    for seed in range(4):
        looks.clear()
        ratios.append(found(cases, seed).probability / P)
        assert not looks[-1]
        assert looks.count(False) == 1
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.2)


LEVELS = np.array([3.0, 3.1, 3.1, 3.2])


def any_beyond(x):
    """Four crash regions, one for each variable: the order holds, and says nothing between them."""
    return (x >= LEVELS).any(axis=1)


ANY = -np.expm1(np.log(norm.cdf(LEVELS)).sum())


def ordered(cases, seed, **options):
    options = {"relative_half_width": 0.2, "max_calls": 600, "risk": cases.increasing(4)} | options
    return estimate(any_beyond, cases.standard_normal(4), seed=seed, **options)


def test_with_an_order_the_places_it_is_silent_about_are_looked_at(cases, monkeypatch):
    looks = []
    look = surveying.survey

    def watched(problem, belief, *others):
        found = yield from look(problem, belief, *others)
        looks.append((belief, found))
        return found

    monkeypatch.setattr(last_look, "survey", watched)
    got = ordered(cases, 3)
    assert got.interval[0] <= ANY <= got.interval[1]
    assert got.stop_reason is StopReason.TARGET_MET
    assert not looks[-1][1].surprised
    for belief, look in looks:
        assert look.whole
        x, y = look.labels.x[belief.labels.n :], look.labels.y[belief.labels.n :]
        h = belief.see(x).surrogate_h
        outside, inside = h < surveying.SURE, h > surveying.SURE_OF_CRASH
        assert surveying.N_EACH * 4 < np.count_nonzero(outside) <= 2 * surveying.N_EACH * 4
        assert np.count_nonzero(inside) == surveying.N_INSIDE
        assert not np.logical_or(*belief.labels.presumed(belief.labels.coordinates(x))).any()
        assert (outside | inside).all()
        assert look.doubted == (not y[inside].all())
        assert look.surprised == (y[outside].any() or not y[h > 1 - surveying.SURE].all())


def test_with_an_order_nothing_is_looked_at_where_it_leaves_little_open(cases, monkeypatch):
    monkeypatch.setattr(surveying, "LITTLE", 1e9)
    looked = ordered(cases, 0)
    monkeypatch.setattr(surveying, "N_EACH", 0)
    assert looked == ordered(cases, 0)


@pytest.fixture(scope="module")
def whole(cases):
    return ordered(cases, 0)


@pytest.mark.parametrize("missing", [1, surveying.N_EACH * 4])
def test_a_look_that_the_budget_cuts_short_does_not_count(cases, whole, missing):
    cut = ordered(cases, 0, max_calls=whole.n_calls - missing)
    assert whole.stop_reason is StopReason.TARGET_MET
    assert cut.n_calls == whole.n_calls - missing
    assert cut.stop_reason is StopReason.BUDGET_ENDED
    assert Alarm.TARGET_UNCHECKED in cut.alarms
    assert Alarm.TARGET_NOT_REACHED not in cut.alarms
    # what the cut look told has its say in the weights
    assert cut.interval == pytest.approx(whole.interval, rel=1e-2)


def surprising(times, looks):
    """A look of which the first `times` are surprised; `looks` is told how many runs there were."""

    def survey(*arguments):
        look = yield from surveying.survey(*arguments)
        looks.append(look.labels.n)
        return replace(look, surprised=look.surprised or len(looks) <= times)

    return survey


def test_with_an_order_rounds_survive_a_surprise_and_another_look_follows(
    cases, whole, monkeypatch
):
    looks = []
    monkeypatch.setattr(last_look, "survey", surprising(1, looks))
    got = ordered(cases, 0)
    assert looks[0] <= whole.n_calls
    assert looks[1] >= looks[0] + 26  # three rounds, the last of which may be of six
    assert got.interval[0] <= ANY <= got.interval[1]
    void, looks[:] = partial(replace, rounds=(), shaken=()), []
    shaken = last_look._shaken
    monkeypatch.setattr(last_look, "_shaken", lambda state: void(shaken(state)))
    assert ordered(cases, 0).n_calls > got.n_calls


def test_a_surprise_at_the_end_of_the_budget_leaves_a_first_idea(cases, whole, monkeypatch):
    """Nothing is left to estimate anew: the rounds before are better than nothing."""
    monkeypatch.setattr(last_look, "survey", surprising(9, []))
    got = ordered(cases, 0, max_calls=whole.n_calls + 5)
    assert got.stop_reason is StopReason.BUDGET_ENDED
    assert got.probability == pytest.approx(ANY, rel=0.3)
    assert got.interval[0] <= got.bounds[0]
    assert got.interval[1] == got.bounds[1] > whole.interval[1]
    assert {Alarm.OUTCOMES_UNFORESEEN, Alarm.UNSETTLED} <= set(got.alarms)


def test_without_an_order_it_does_too(cases, monkeypatch):
    whole = found(cases, 0)
    assert whole.stop_reason is StopReason.TARGET_MET
    monkeypatch.setattr(last_look, "survey", surprising(9, []))
    got = found(cases, 0, max_calls=whole.n_calls + 5)
    assert got.stop_reason is StopReason.BUDGET_ENDED
    assert got.probability == pytest.approx(P, rel=0.3)
    assert got.interval[0] == 0.0
    assert got.interval[1] > 3 * whole.interval[1]
    assert {Alarm.OUTCOMES_UNFORESEEN, Alarm.UNSETTLED} <= set(got.alarms)


def beyond(x):
    return x.sum(axis=1) >= np.sqrt(2) * norm.isf(1e-4)


def looked_last(cases, risk, outcomes):
    """What a campaign believes, where it looks last, and what it makes of `outcomes` there."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(exploration, "MESH", 0)
        options = {"max_calls": 240, "relative_half_width": 0.01}
        campaign = Campaign(cases.standard_normal(2), risk=risk, **options)
        while not campaign.done:
            campaign.tell(beyond(campaign.ask()))
    problem, belief = campaign.problem, campaign.snapshot.belief
    more = replace(problem, max_calls=1_000)
    look = surveying.survey(
        more, belief, lambda: (belief.surrogate,), campaign.snapshot, np.random.default_rng(0)
    )
    query, asked = next(look), []
    try:
        while True:
            asked.append(query.x)
            query = look.send(outcomes(query.x).astype(float))
    except StopIteration as end:
        return belief, np.concatenate(asked), end.value


@pytest.mark.parametrize("ordered", [True, False])
def test_the_last_look_goes_where_only_the_surrogate_sees_crashes(cases, ordered):
    risk = cases.increasing(2) if ordered else None
    belief, x, look = looked_last(cases, risk, beyond)
    x = x if ordered else x[N_OUTSIDE:]
    inside = belief.see(x).surrogate_h > surveying.SURE_OF_CRASH
    most = surveying.N_INSIDE if ordered else surveying.N_UNORDERED
    assert 1 <= np.count_nonzero(inside) <= most
    assert not np.logical_or(*belief.labels.presumed(belief.labels.coordinates(x[inside]))).any()
    assert beyond(x[inside]).all()
    assert not look.surprised
    assert not look.doubted


@pytest.mark.parametrize("ordered", [True, False])
def test_a_safe_outcome_where_crashes_were_sure_is_a_surprise(cases, ordered):
    risk = cases.increasing(2) if ordered else None
    look = looked_last(cases, risk, lambda x: np.zeros(len(x)))[2]
    assert look.surprised
    assert look.doubted
    # failed runs say nothing
    look = looked_last(cases, risk, lambda x: np.where(beyond(x), np.nan, 0.0))[2]
    assert not look.surprised
    assert not look.doubted


def test_where_crashes_were_only_likely_a_safe_one_is_a_doubt(cases, monkeypatch):
    monkeypatch.setattr(surveying, "SURE", 0.0)
    look = looked_last(cases, cases.increasing(2), lambda x: np.zeros(len(x)))[2]
    assert look.doubted
    assert not look.surprised


def test_supposed_crashes_are_drawn_as_traffic_has_them(cases, monkeypatch):
    monkeypatch.setattr(surveying, "N_UNORDERED", 300)
    x = looked_last(cases, None, beyond)[1][N_OUTSIDE:]
    level = norm.isf(1e-4)
    past = x.sum(axis=1) / np.sqrt(2) - level
    assert len(x) > 100
    # as far past the edge as traffic goes; the pool that they are drawn from keeps to it
    assert past.mean() == pytest.approx(norm.pdf(level) / norm.sf(level) - level, abs=0.06)


def test_nothing_is_supposed_where_simulations_fail(cases, monkeypatch):
    monkeypatch.setattr(surveying, "see", lambda *a: replace(v := see(*a), failing=v.h > 0.5))
    assert len(looked_last(cases, None, beyond)[1]) == N_OUTSIDE


def test_where_little_hangs_on_the_surrogate_it_is_not_asked(cases, monkeypatch):
    monkeypatch.setattr(surveying, "LITTLE", 1e9)
    assert len(looked_last(cases, None, beyond)[1]) == N_OUTSIDE


def test_without_an_order_the_last_look_is_at_places_as_likely_as_the_likeliest_crash(cases):
    belief, x, look = looked_last(cases, None, beyond)
    traffic, labels = cases.standard_normal(2), belief.labels
    outside = x[: surveying.N_ALIKE + surveying.N_BESIDE]
    less = traffic.log_density(labels.crashes).max() - traffic.log_density(outside)
    assert less.max() < 2 * surveying.BELOW
    assert less.min() > -surveying.ABOVE
    assert (belief.see(outside).surrogate_h < surveying.SURE).all()
    towards = outside.sum(axis=1) / np.sqrt(2)
    assert towards[: surveying.N_ALIKE].min() < 0  # on every side of the origin
    denser = x[surveying.N_ALIKE + surveying.N_BESIDE : N_OUTSIDE]
    more = traffic.log_density(denser) - traffic.log_density(labels.crashes).max()
    assert more.min() >= surveying.ABOVE
    assert not look.surprised


def test_the_widened_fit_has_the_share_beside_what_was_fitted():
    narrow, wide = (Gaussians(np.ones(1), np.zeros((1, 2)), s * np.eye(2)[None]) for s in (1, 9))
    traffic = Gaussians(np.ones(1), np.full((1, 2), -20.0), np.eye(2)[None])
    proposal = Blend(aiming.SHARES, (narrow, wide, traffic, traffic))
    x = np.array([[0.0, 0.0], [5.0, 0.0], [-20.0, -20.0]])
    places = SimpleNamespace(x=x, log_q=proposal.log_density(x))
    assert aiming.beside(proposal, places) == pytest.approx([1 / (1 + 7 * 9), 1, 0], abs=1e-3)
    assert aiming.beside(narrow, places).tolist() == [1, 1, 1]


def test_the_farthest_are_weighed_by_their_worth():
    z, known, rows = np.array([[1.0], [2.0], [4.0], [9.0]]), np.zeros((1, 1)), np.array([0, 1, 2])
    assert farthest_as_scaled(z, known, rows, 2).tolist() == [2, 1]
    worth = np.array([1.0, 5.0, 1.0, 100.0])
    assert farthest_as_scaled(z, known, rows, 2, worth).tolist() == [1, 2]
    assert farthest_as_scaled(z, known, rows[:0], 2, worth).tolist() == []


def ring(x):
    radius = np.hypot(*x.T)
    return (radius >= 3.8) & (radius <= 4.2)


RING = np.exp(-(3.8**2) / 2) - np.exp(-(4.2**2) / 2)


def test_a_thin_ring_is_found_whole(cases, monkeypatch):
    """Where it is not looked at places as likely as the likeliest crash, part of it is lost."""
    seed = 4
    got = found(cases, seed, ring, max_calls=800)
    assert got.stop_reason is StopReason.TARGET_MET
    assert got.interval[0] <= RING <= got.interval[1]
    monkeypatch.setattr(surveying, "N_ALIKE", 0)
    monkeypatch.setattr(surveying, "N_BESIDE", 0)
    monkeypatch.setattr(exploration, "MESH", 0)
    assert found(cases, seed, ring, max_calls=800).interval[1] < 0.9 * RING


def test_surveys_come_to_an_end(cases, monkeypatch):
    """Every look a surprise: the campaign stops after so many, the target met."""

    def surprised(*arguments):
        look = yield from surveying.survey(*arguments)
        return replace(look, surprised=True)

    monkeypatch.setattr(last_look, "survey", surprised)
    for module in (sequential, last_look):
        monkeypatch.setattr(module, "MAX_SURVEYS", 2)
    got = found(cases, 0)
    assert got.stop_reason in {StopReason.TARGET_MET, StopReason.BUDGET_ENDED}
    assert Alarm.OUTCOMES_UNFORESEEN in got.alarms


def test_a_tighter_target_is_looked_at_anew(cases):
    """A look is for the target that was met, and for wider ones."""
    problem = partial(Problem, traffic=cases.standard_normal(2))
    looked = SimpleNamespace(surveyed_for=0.2, labels=SimpleNamespace(n=100))
    assert last_look.surveyed(problem(relative_half_width=0.2), looked)
    assert last_look.surveyed(problem(relative_half_width=0.3), looked)
    assert not last_look.surveyed(problem(relative_half_width=0.1), looked)
    earlier = problem(relative_half_width=0.1, earlier_targets=((0.2, 101),))
    assert last_look.surveyed(earlier, looked)


def test_a_campaign_that_looks_again_is_not_finished(cases):
    campaign = Campaign(cases.standard_normal(2), seed=1, relative_half_width=0.3, max_calls=400)
    while not campaign.done:
        assert campaign.estimate().stop_reason is StopReason.RUNNING
        campaign.tell(two_sides(campaign.ask()))
    assert campaign.estimate().stop_reason is StopReason.TARGET_MET


def rarely(x):
    return two_sides(x, norm.isf(1e-4))


def unlucky(cases, n):
    """Seeds of whose thirty random encounters one crashes, as of one campaign in 170."""
    from crashrate.estimation.strategy import Problem

    traffic, seeds = cases.standard_normal(2), []
    for seed in range(2000):
        rng = Problem(traffic=traffic, seed=seed).rng(sequential.ENCOUNTERS)
        if rarely(traffic.sample(30, rng)).any():
            seeds.append(seed)
        if len(seeds) == n:
            return seeds
    raise AssertionError


def test_an_unlucky_encounter_is_outvoted_by_more_of_them(cases, check_coverage, monkeypatch):
    seeds, crashed = unlucky(cases, 4), []
    meet = sequential.meet

    def counted(*arguments):
        labels, met = yield from meet(*arguments)
        crashed[-1] += met.n_crashes
        return labels, met

    def campaign(seed):
        crashed.append(0)
        return found(cases, seed, rarely)

    monkeypatch.setattr(sequential, "meet", counted)
    got = [campaign(seed) for seed in seeds]
    # a second one, as rare again, would take a thousand more
    outvoted = [g for g, n in zip(got, crashed, strict=True) if n == 1]
    assert len(outvoted) >= 3
    assert all(g.stop_reason is StopReason.TARGET_MET for g in outvoted)
    assert all(Alarm.ENCOUNTERS_DISAGREE not in g.alarms for g in outvoted)
    check_coverage([g.interval for g in got], 2e-4)
    monkeypatch.setattr(sequential, "outvoted", lambda *_: False)
    stuck = found(cases, seeds[0], rarely, max_calls=got[0].n_calls)
    assert Alarm.ENCOUNTERS_DISAGREE in stuck.alarms
    assert stuck.interval[1] > 0.05


def test_a_larger_budget_goes_on_from_a_smaller_one(cases):
    options = {"seed": 3, "relative_half_width": 0.3}

    def run(n):
        campaign = Campaign(cases.standard_normal(2), max_calls=n, **options)
        while not campaign.done:
            campaign.tell(two_sides(campaign.ask()))
        return campaign

    whole = run(400)
    for n in (40, 55, whole.n_calls - 3):
        part = run(n)
        assert part.n_calls == n
        assert np.array_equal(part.x, whole.x[:n])
        assert part.estimate().interval[1] >= P
