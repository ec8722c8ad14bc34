"""Campaigns with consequences: exact expectations, aims, and what is refused."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from crashrate.errors import InvalidInputError
from crashrate.estimation import carried, sequential
from crashrate.estimation import consequences as learning
from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.estimation.campaign import Campaign
from crashrate.estimation.carried import carry
from crashrate.estimation.run import estimate

P = 1e-3
LEVEL, SEVERE, DEPTH = norm.isf(P), norm.isf(P / 5), 0.6
RAMP, _ = quad(lambda s: (s - LEVEL) / DEPTH * norm.pdf(s), LEVEL, LEVEL + DEPTH, epsrel=1e-10)
TRUTHS = {
    "depth": RAMP + norm.sf(LEVEL + DEPTH),
    "severe": P / 5,
    "side": P / 2,
    "chance": 0.3 * P,
}
NAMES = tuple(TRUTHS)


def simulator(seed=0, fail=0.0):
    rng = np.random.default_rng((seed, 1))

    def simulate(x):
        s = x.sum(axis=1) / math.sqrt(2)
        ones = np.ones(len(x))
        depth = np.clip((s - LEVEL) / DEPTH, 0, 1)
        chance = rng.random(len(x)) < 0.3
        told = np.column_stack([ones, depth, s > SEVERE, x[:, 0] > x[:, 1], chance])
        told *= (s > LEVEL)[:, None]
        told[rng.random(len(x)) < fail] = np.nan
        return told

    return simulate


@pytest.fixture
def go(cases, small):  # noqa: ARG001
    def go(simulate=None, **options):
        settings = {
            "risk": cases.increasing(2),
            "consequences": NAMES,
            "relative_half_width": 0.2,
            "max_calls": 600,
        }
        settings |= options
        seed = settings.setdefault("seed", 0)
        return estimate(simulate or simulator(seed), cases.standard_normal(2), **settings)

    return go


@pytest.fixture
def campaign(cases):
    def campaign(**options):
        settings = {"consequences": NAMES} | options
        return Campaign(cases.standard_normal(2), risk=cases.increasing(2), **settings)

    return campaign


def test_intervals_hold_the_exact_expectations(go, check_coverage, check_mean):
    found = [{c.name: c for c in go(seed=seed).consequences} for seed in range(12)]
    for name, truth in TRUTHS.items():
        check_coverage([f[name].interval for f in found], truth)
        check_mean([f[name].mean for f in found], truth)


def test_what_is_learned_is_no_truth_of_its_own(go, monkeypatch, check_coverage):
    # negative control: with wrong expectations that are trusted the intervals miss; corrected by
    # the draws they hold
    wrong = lambda seen, z, asked: (np.full(len(asked), 0.9), np.full(len(asked), 0.01))  # noqa: ARG005, E731
    monkeypatch.setattr(learning, "_learned", wrong)
    corrected = [go(seed=seed, consequences=NAMES).consequences[0] for seed in range(8)]
    check_coverage([c.interval for c in corrected], TRUTHS["depth"])

    def trust(view, drawn, y, z):  # noqa: ARG001
        as_held = np.column_stack([held.mean[drawn.rows] for held in view.consequences])
        return carry(view, drawn, y, as_held)

    monkeypatch.setattr(sequential, "carry", trust)
    trusting = [go(seed=seed).consequences[0] for seed in range(8)]
    with pytest.raises(AssertionError, match="intervals hold"):
        check_coverage([c.interval for c in trusting], TRUTHS["depth"])


@pytest.mark.parametrize("aim", ["depth", "severe"])
def test_an_aim_is_what_target_and_stop_are_for(go, aim):
    got = go(aim=aim, max_calls=1000)
    k = NAMES.index(aim)
    plain, aimed = go(max_calls=400).consequences[k], got.consequences[k]
    assert got.stop_reason is StopReason.TARGET_MET
    assert aimed.aimed
    assert not plain.aimed
    assert aimed.relative_half_width <= 0.2
    assert aimed.determined
    if aim == "severe":
        assert plain.relative_half_width > 0.2


def test_a_random_consequence_can_be_aimed_at(go, check_coverage):
    found = [go(seed=s, aim="chance", relative_half_width=0.5).consequences[3] for s in range(3)]
    check_coverage([c.interval for c in found], TRUTHS["chance"])
    assert max(c.relative_half_width for c in found) <= 0.5


def test_the_default_aim_spends_runs_as_without_consequences(go, cases):
    with_them = go(seed=3)
    alone = go(lambda x: simulator()(x)[:, 0], seed=3, consequences=())
    assert alone.consequences == ()
    assert with_them.probability == alone.probability
    assert with_them.history == alone.history
    assert cases.half_plane(P).estimate(relative_half_width=0.2).consequences == ()


def test_a_consequence_never_seen_is_no_less_likely_than_the_draws_say(go):
    def without(x):
        return simulator()(x)[:, :1] * [1, 0]

    got = go(without, consequences=("rare",))
    (rare,) = got.consequences
    assert rare.n_carrying == 0
    assert not rare.determined
    assert Alarm.CONSEQUENCE_UNDETERMINED in got.alarms
    n_crashes = got.n_crashes
    assert rare.interval[0] == 0
    assert got.interval[1] >= rare.interval[1] > got.interval[0] * 3 / n_crashes
    assert "not determined, 0 simulator runs had it" in rare.sentence()


def test_failed_simulations_widen_as_they_do_for_the_event(go):
    got = go(simulator(fail=0.05), seed=2)
    assert got.n_failed > 0
    assert Alarm.SIMULATIONS_FAILED in got.alarms
    for c in got.consequences:
        assert c.interval[0] <= TRUTHS[c.name] <= c.interval[1]


def test_without_an_order_they_are_estimated_too(go, check_coverage):
    found = [go(seed=seed, risk=None, relative_half_width=0.3).consequences for seed in range(4)]
    for k, name in enumerate(NAMES):
        check_coverage([f[k].interval for f in found], TRUTHS[name])


def test_with_members_the_average_is_meant(go, cases, small, check_coverage):  # noqa: ARG001
    one = cases.standard_normal(2)
    wide = replace(one, covariances=1.2**2 * one.covariances)
    both = replace(one, members=(one, wide))

    def depth(sd):
        density = lambda s: min((s - LEVEL) / DEPTH, 1.0) * norm.pdf(s, scale=sd)  # noqa: E731
        return quad(density, LEVEL, LEVEL + DEPTH)[0] + norm.sf(LEVEL + DEPTH, scale=sd)

    found = [
        estimate(
            simulator(seed),
            both,
            risk=cases.increasing(2),
            consequences=NAMES,
            aim="depth",
            relative_half_width=0.2,
            max_calls=300,
            seed=seed,
        )
        for seed in range(8)
    ]
    aimed = [e.consequences[0] for e in found]
    check_coverage([c.interval for c in aimed], (depth(1.0) + depth(1.2)) / 2)
    for k, sd in enumerate((1.0, 1.2)):
        told = [
            (c.traffic_range.probabilities[k], c.traffic_range.standard_errors[k]) for c in aimed
        ]
        ends = [(p - 2.3 * error, p + 2.3 * error) for p, error in told]  # 95 % by Student's t
        check_coverage(ends, depth(sd))
        with pytest.raises(AssertionError, match="intervals hold"):
            check_coverage(ends, depth(2.2 - sd))  # the other's
    # the crash itself is another number, and has its own
    assert all(
        e.traffic_range.probabilities > e.consequences[0].traffic_range.probabilities for e in found
    )
    said = found[0].to_dict()["consequences"][0]["traffic_range"]["sentence"]
    assert said.startswith("traffic models, E(depth): ")
    assert "whose mean is the expectation above" in said


def test_traffic_models_that_disagree_on_what_is_aimed_at_raise_an_alarm(cases, small):  # noqa: ARG001
    """They agree on the crash: only how deep it goes differs."""
    one = cases.standard_normal(2)
    shifted = replace(one, means=np.add(one.means, [[2.5, -2.5]]))
    options = {"risk": cases.increasing(2), "consequences": ["side"], "relative_half_width": 0.3}

    def simulate(x):
        crash = x.sum(axis=1) > math.sqrt(2) * LEVEL
        return np.column_stack([crash, crash & (x[:, 0] < x[:, 1] - 1.5)])

    both = replace(one, members=(one, shifted))
    event, aimed = (estimate(simulate, both, **options, aim=aim) for aim in (None, "side"))
    assert Alarm.TRAFFIC_UNDETERMINED not in event.alarms
    assert Alarm.TRAFFIC_UNDETERMINED in aimed.alarms
    alone = estimate(simulate, replace(one, members=(one, one)), **options, aim="side")
    assert Alarm.TRAFFIC_UNDETERMINED not in alone.alarms


def test_a_rare_severe_outcome_that_no_run_had_is_not_excluded(
    cases,
    small,  # noqa: ARG001
    check_coverage,
    monkeypatch,
):
    """A thousandth in most crashes, 1 in one of fifty: half of the campaigns see none of those."""
    truth = norm.sf(4.0) * (0.02 + 0.98 * 0.001)

    def severe(seed):
        rng = np.random.default_rng((seed, 9))

        def simulate(x):
            crash = x.sum(axis=1) > 4.0 * math.sqrt(2)
            return np.column_stack([crash, crash * np.where(rng.random(len(x)) < 0.02, 1.0, 1e-3)])

        return estimate(
            simulate,
            cases.standard_normal(2),
            risk=cases.increasing(2),
            consequences=["injury"],
            aim="injury",
            relative_half_width=0.5,
            max_calls=120,
            seed=seed,
        )

    found = [severe(seed) for seed in range(6)]
    check_coverage([e.consequences[0].interval for e in found], truth)
    assert all(e.stop_reason is StopReason.BUDGET_ENDED for e in found)
    assert all(Alarm.CONSEQUENCE_UNDETERMINED in e.alarms for e in found)
    monkeypatch.setattr(carried, "ENOUGH", 0.0)
    monkeypatch.setattr(carried, "ENOUGH_DRAWN", 0.0)
    blind = [severe(seed) for seed in range(6)]
    missed = [e for e in blind if e.consequences[0].interval[1] < truth]
    assert len(missed) >= 2


def test_a_mapping_is_told_like_an_array(go):
    def mapped(x):
        told = simulate(x)
        return {name: told[:, k] for k, name in enumerate(("crash", *NAMES))}

    simulate = simulator(4)
    one = go(mapped, seed=4)
    assert one == go(simulator(4), seed=4)


def test_the_record_is_ready_for_json(go):
    record = go().to_dict("hour")
    text = json.loads(json.dumps(record, allow_nan=False))
    assert [c["name"] for c in text["consequences"]] == list(NAMES)
    assert "per hour" in text["consequences"][0]["sentence"]
    assert {"mean", "interval", "n_eff", "determined"} <= set(text["consequences"][0])


def test_no_crash_leaves_the_event_and_its_consequences_the_same_upper_end(go):
    got = go(lambda x: np.zeros((len(x), 5)), max_calls=60)
    assert {c.interval for c in got.consequences} == {got.interval}
    assert {c.mean for c in got.consequences} == {0.0}


def test_before_an_estimate_nothing_is_known(campaign):
    got = campaign().estimate()
    assert [c.interval for c in got.consequences] == [(0.0, 1.0)] * 4
    assert all(math.isnan(c.mean) for c in got.consequences)


def test_outcomes_and_consequences_of_a_campaign(campaign):
    c = campaign(consequences=("injury",))
    assert c.consequences.shape == (0, 1)
    x = c.ask()
    with pytest.raises(InvalidInputError, match="let the event be the widest"):
        c.tell(np.tile([0, 0.5], (len(x), 1)))
    c.tell(np.tile([1, 0.5], (len(x), 1)))
    np.testing.assert_array_equal(c.outcomes, np.ones(len(x)))
    np.testing.assert_array_equal(c.consequences, np.full((len(x), 1), 0.5))


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"aim": "dept"}, "one of the consequences.*did you mean 'depth'"),
        ({"aim": "injury", "consequences": ()}, "aim: .* none is declared"),
        ({"method": "crude"}, "the method 'crude'"),
        ({"method": "huang2017"}, "the method 'huang2017'"),
        ({"method": "cross-entropy"}, "the method 'cross-entropy'"),
        ({"goal": "bounds"}, "the goal 'bounds'"),
        ({"consequences": "injury"}, "expected names"),
        ({"consequences": None}, "expected names.*got None"),
    ],
)
def test_what_cannot_be_is_refused(campaign, options, says):
    with pytest.raises(InvalidInputError, match=says):
        campaign(**options)
