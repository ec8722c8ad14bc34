"""Rounds directed at members whose crashes are few under the average."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from crashrate.estimation import kernels, sequential
from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.estimation.campaign import Campaign
from crashrate.estimation.direction import NEGLIGIBLE, towards, unclear
from crashrate.estimation.rounds import Round, Sums, combine, measure
from crashrate.estimation.run import estimate
from crashrate.estimation.selection import to_estimate
from crashrate.estimation.traffic_range import MIN_N_EFF, TrafficRange
from crashrate.traffic.model import TrafficModel

LEVEL = 4.0
RISK = {"a": "increasing", "b": "increasing"}
# across the crash set's edge, and along it: the last member's crashes are few, and elsewhere
PLACES = ((0.0, 0.0), (0.2, 0.0), (-0.2, 0.0), (0.1, 0.3), (0.3, -0.3), (-0.8, 4.0))
EXACT = norm.sf(LEVEL - np.array([across for across, _ in PLACES]))


def member(across, along):
    mean = np.array([[across + along, across - along]]) / math.sqrt(2)
    return TrafficModel([1.0], mean, np.eye(2)[None], [-np.inf] * 2, [np.inf] * 2, ["a", "b"])


def family(places=PLACES):
    members = [member(*place) for place in places]
    return replace(members[0], members=members)


def crash(x):
    return x.sum(axis=1) / math.sqrt(2) > LEVEL


def found(seed, **options):
    options = {"relative_half_width": 0.2} | options
    return estimate(crash, family(), risk=RISK, seed=seed, **options)


@pytest.fixture(scope="module")
def studies():
    with pytest.MonkeyPatch.context() as patch:  # quicker
        patch.setattr(kernels, "KERNELS", (kernels.Kernel(0.5, 2.0, 1e3),))
        patch.setattr(kernels, "ADDITIVE", ())
        return [found(seed) for seed in range(12)]


def test_every_member_is_determined_without_bias(studies, check_mean):
    assert all(s.traffic_range.n_undetermined == 0 for s in studies)
    for k, truth in enumerate(EXACT):
        p = np.array([s.traffic_range.probabilities[k] for s in studies])
        check_mean(p, truth)
        with pytest.raises(AssertionError, match="z ="):
            check_mean(p + 5 * p.std(), truth)


def test_standard_errors_are_honest(studies):
    errors = np.array([s.traffic_range.standard_errors for s in studies])
    z = (np.array([s.traffic_range.probabilities for s in studies]) - EXACT) / errors
    assert np.mean(np.abs(z) < 2.5) > 0.95
    assert np.mean(np.abs(z + EXACT / errors) < 2.5) < 0.5  # the check can fail


def test_the_average_keeps_its_target_and_its_coverage(studies, check_coverage):
    assert {s.stop_reason for s in studies} == {StopReason.TARGET_MET}
    assert all(s.relative_half_width <= 0.2 for s in studies)
    assert all(Alarm.MEMBERS_UNDETERMINED not in s.alarms for s in studies)
    check_coverage([s.interval for s in studies], EXACT.mean())


def test_without_directed_rounds_the_member_stays_unclear(monkeypatch):
    with_them = found(0)
    monkeypatch.setattr(sequential, "MAX_ROUNDS", 0)
    without = found(0)
    assert without.traffic_range.n_eff[-1] < MIN_N_EFF < with_them.traffic_range.n_eff[-1]
    assert Alarm.MEMBERS_UNDETERMINED in without.alarms
    assert without.n_calls < with_them.n_calls <= without.n_calls + 60
    n = len(without.history)  # only then
    assert with_them.history[: n - 1] == without.history[: n - 1]
    assert with_them.history[n - 1].probability == without.probability


def run(campaign):
    while not campaign.done:
        campaign.tell(crash(campaign.ask()))
    return campaign


def test_a_larger_budget_goes_on_from_a_smaller_one(small, monkeypatch):  # noqa: ARG001
    options = {"risk": RISK, "relative_half_width": 0.3, "seed": 1}
    whole = run(Campaign(family(), **options))
    with monkeypatch.context() as patch:
        patch.setattr(sequential, "MAX_ROUNDS", 0)
        first = run(Campaign(family(), **options)).n_calls
    assert first < whole.n_calls
    for n in (first, first + 7, first + 13, whole.n_calls):
        part = run(Campaign(family(), max_calls=n, **options))
        assert part.n_calls <= n
        assert part.estimate().stop_reason is StopReason.TARGET_MET
        assert np.array_equal(part.x, whole.x[: part.n_calls])


def test_another_target_goes_on_from_runs_directed_at_members(small, monkeypatch):  # noqa: ARG001
    options = {"risk": RISK, "seed": 1}
    loose = run(Campaign(family(), relative_half_width=0.3, **options))
    with monkeypatch.context() as patch:
        patch.setattr(sequential, "MAX_ROUNDS", 0)
        assert run(Campaign(family(), relative_half_width=0.3, **options)).n_calls < loose.n_calls
    n = loose.n_calls
    tight = run(Campaign(family(), relative_half_width=0.1, earlier_targets=[(0.3, n)], **options))
    assert tight.n_calls > n
    assert np.array_equal(tight.x[:n], loose.x)
    assert tight.estimate().relative_half_width <= 0.1
    forgetful = run(Campaign(family(), relative_half_width=0.1, **options))
    assert not np.array_equal(forgetful.x[:n], loose.x)  # the test can fail


def test_a_campaign_that_goes_on_says_so(small):  # noqa: ARG001
    campaign = Campaign(family(), risk=RISK, relative_half_width=0.3, seed=1)
    while not campaign.done:
        assert campaign.snapshot.stop_reason is StopReason.RUNNING
        campaign.tell(crash(campaign.ask()))
    assert campaign.snapshot.stop_reason is StopReason.TARGET_MET


def test_members_far_below_the_others_eat_no_runs():
    far = 0.9 * NEGLIGIBLE * 1e-6
    errors = (1e-8, 1e-8, 1e-8, 1e-6, far / 2, far)
    got = unclear(TrafficRange((1e-6, 1e-6, 1e-6, 1e-6, 0.0, 0.0), errors))
    assert got == (3, 5)  # two standard errors up, the fourth is still far below
    assert unclear(None) == ()


def test_each_member_looked_at_has_an_equal_share_of_the_crashes(toy_view):
    view, _ = viewed(toy_view)
    assert towards(view, ()) is view
    theirs = towards(view, (0, 2))
    crashes = theirs.weights * view.h
    expected = sum(p / p.sum() for p in (view.weights * view.h * view.pool.ratios.T)[[0, 2]])
    assert crashes / crashes.sum() == pytest.approx(expected / 2)


def viewed(toy_view):
    """The toy view, with three members: one as the average, one each way along the edge."""
    view, outcomes = toy_view(np.random.default_rng(0))
    along = view.pool.x[:, 0] - view.pool.x[:, 1]
    ratios = np.exp(np.outer(along, [-1.0, 0.0, 1.5]))
    return replace(view, pool=replace(view.pool, ratios=ratios)), outcomes


def redrawn(view, outcomes, told, times=3000):
    rng, rounds = np.random.default_rng(1), []
    wanted = towards(view, (2,))
    for _ in range(times):
        drawn = to_estimate(view, 6, rng, wanted)
        drawn = replace(drawn, probabilities=told(drawn.probabilities))
        rounds.append(measure(view, drawn, outcomes[drawn.rows]))
    return np.array([[r.estimate, *r.members.estimates] for r in rounds])


def test_a_directed_round_is_unbiased_for_the_average_and_every_member(toy_view, check_mean):
    view, outcomes = viewed(toy_view)
    truth = [view.weights @ outcomes, *((view.weights * outcomes) @ view.pool.ratios)]
    right = redrawn(view, outcomes, lambda probabilities: probabilities)
    wrong = redrawn(view, outcomes, lambda _: np.full(len(view.h), 1 / len(view.h)))
    for k in range(4):
        check_mean(right[:, k], truth[k])
        with pytest.raises(AssertionError, match="z ="):
            check_mean(wrong[:, k], truth[k])


def rounds_of(rng, sd, over_confidence=1.0, seen=1.0):
    """Rounds about one member whose probability is 1, with relative deviations `sd` (R,)."""
    rounds = []
    for s, share in zip(sd, np.broadcast_to(seen, len(sd)), strict=True):
        got, true = share * (1 + 0.1 * rng.standard_normal()), over_confidence * s * share
        estimate = share + true * rng.standard_normal()
        squares = true**2 * rng.chisquare(6) / 6
        sums = Sums(*(np.array([v]) for v in (estimate, got, (got * s) ** 2, squares)))
        rounds.append(Round(6, 1.0, 1.0, 1.0, 1.0, 1.0, 0.01, 0.01, 0.1, members=sums))
    return rounds


ORDINARY, DIRECTED = [3.0] * 8, [0.3] * 3


def test_a_member_has_its_own_shares_of_the_rounds(check_mean):
    rng = np.random.default_rng(2)
    got = [combine(rounds_of(rng, ORDINARY + DIRECTED), 0.95).members for _ in range(400)]
    p, errors = (
        np.array([getattr(g, k)[0] for g in got]) for k in ("probabilities", "standard_errors")
    )
    check_mean(p, 1.0)
    assert p.std() < 0.25  # equal shares would have 0.8
    assert np.mean(np.abs(p - 1) < 2 * errors) > 0.9
    assert np.mean(np.abs(p - 1.8) < 2 * errors) < 0.3  # the check can fail


def test_surprises_of_a_member_widen_its_own_error():
    rng = np.random.default_rng(3)
    got = [combine(rounds_of(rng, DIRECTED * 3, over_confidence=2.0), 0.95) for _ in range(200)]
    p = np.array([g.members.probabilities[0] for g in got])
    errors = np.array([g.members.standard_errors[0] for g in got])
    assert np.mean(np.abs(p - 1) < 2 * errors) > 0.85
    assert np.median(errors) > 1.3 * 0.1
    calm = combine(rounds_of(rng, DIRECTED * 3), 0.95).standard_error
    assert 0.7 * 0.1 / 3 < calm < 0.1 / 3  # the average's rounds do not scatter at all
    assert all(g.standard_error == pytest.approx(calm) for g in got)  # and its error is its own


def test_rounds_that_had_not_seen_the_members_crashes_are_left_out():
    rng = np.random.default_rng(4)
    rounds = rounds_of(rng, [0.3] * 8, seen=[0.1] * 5 + [1.0] * 3)
    got = combine(rounds, 0.95).members
    assert got.probabilities == combine(rounds[5:], 0.95).members.probabilities
