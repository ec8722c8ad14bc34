"""Ask, tell, estimate: order of calls, budgets, repeatability."""

import numpy as np
import pytest

import crashrate
from crashrate.errors import CallOrderError, InvalidInputError
from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.estimation.campaign import Campaign
from crashrate.expressions import Expression


def run(campaign, simulate):
    while not campaign.done:
        campaign.tell(simulate(campaign.ask()))
    return campaign.estimate()


@pytest.fixture
def case(cases, small):  # noqa: ARG001
    return cases.half_plane(1e-2)


def test_nothing_is_known_before_anything_is_told(case):
    got = case.campaign().estimate()
    assert np.isnan(got.probability)
    assert got.interval == (0.0, 1.0)
    assert (got.n_calls, got.n_crashes, got.n_failed) == (0, 0, 0)
    assert got.stop_reason is StopReason.RUNNING
    assert got.alarms == ()
    assert got.history == ()


def test_ask_twice_names_the_remedy(case):
    campaign = case.campaign()
    n = len(campaign.ask())
    with pytest.raises(CallOrderError, match=rf"the last {n} situations.*campaign\.tell"):
        campaign.ask()


def test_tell_before_ask_names_the_remedy(case):
    with pytest.raises(CallOrderError, match=r"campaign\.ask\(\) first"):
        case.campaign().tell([1])


def test_tell_twice_is_refused(case):
    campaign = case.campaign()
    y = case.crash(campaign.ask())
    campaign.tell(y)
    with pytest.raises(CallOrderError, match="nothing was asked"):
        campaign.tell(y)


def test_done_may_be_read_between_ask_and_tell(case):
    campaign = case.campaign()
    x = campaign.ask()
    assert not campaign.done
    campaign.tell(case.crash(x))
    assert campaign.n_calls == len(x)


def test_ask_when_done_names_the_remedy(case):
    campaign = case.campaign(max_calls=3)
    run(campaign, case.crash)
    with pytest.raises(CallOrderError, match=r"budget of simulator runs ended.*estimate\(\)"):
        campaign.ask()
    with pytest.raises(CallOrderError, match="nothing was asked"):
        campaign.tell([])


@pytest.mark.parametrize(
    ("outcomes", "message"),
    [
        ([], "expected 1 outcome"),
        ([0, 1], r"expected 1 outcome.*\(2,\)"),
        ([0, [1, 0]], r"expected 1 outcome.*got \[0, \[1, 0\]\], of unequal lengths"),
        ([[0]], r"got shape \(1, 1\)"),
        ([0.5], r"got 0\.5 at row 0"),
        ([-1], r"True, False or NaN"),
        ([0.3], "where the simulator gives a probability draw the outcome by it"),
        ([np.inf], "got inf"),
    ],
)
def test_outcomes_are_checked_and_can_be_told_again(case, outcomes, message):
    campaign = case.campaign()
    campaign.ask()
    with pytest.raises(InvalidInputError, match=message):
        campaign.tell(outcomes)
    campaign.tell([True])
    assert campaign.outcomes.tolist() == [1.0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"relative_half_width": 0}, "relative_half_width: expected a number above 0 .*, got 0"),
        ({"max_calls": 0}, "max_calls: expected at least 1, got 0"),
        ({"confidence": 1.0}, "confidence: expected a number between 0 and 1"),
        ({"confidence": 95}, "confidence: expected a number between 0 and 1"),
        ({"batch_size": 0}, "batch_size: expected at least 1"),
        ({"seed": -1}, "seed: expected a non-negative integer"),
        ({"method": "sequentiel"}, "did you mean 'sequential'"),
        ({"goal": ["bounds"]}, r"goal: expected a known one, got \['bounds'\]"),
        ({"method": None}, "method: expected a known one, got None"),
        ({"goal": "bound"}, "goal: expected a known one, got 'bound'; did you mean 'bounds'"),
        ({"goal": "bounds", "method": "huang2017"}, "served by the method sequential, got 'huang"),
        ({"goal": "bounds", "risk": None}, "goal: 'bounds' needs a risk order"),
        ({"risk": {"c": "increasing"}}, "not a variable"),
        ({"risk": {"a": "up"}}, "expected 'increasing' or 'decreasing'"),
    ],
)
def test_arguments_are_checked(case, options, message):
    with pytest.raises(InvalidInputError, match=message):
        case.campaign(**options)


def test_what_was_asked_cannot_be_changed_from_outside(case):
    campaign = case.campaign()
    x = campaign.ask()
    kept = x.copy()
    x += 100
    campaign.tell([True])
    assert np.array_equal(campaign.x, kept)


def test_equal_bits_for_the_same_seed_and_others_for_another(case):
    one, same, other = (case.campaign(seed=s, max_calls=60) for s in (3, 3, 4))
    got = [run(c, case.crash) for c in (one, same, other)]
    assert got[0] == got[1]
    assert np.array_equal(one.x, same.x)
    assert got[0].probability != got[2].probability
    assert not np.array_equal(one.x[:20], other.x[:20])


def test_random_state_of_the_program_does_not_matter(case):
    first = run(case.campaign(max_calls=40), case.crash)
    np.random.seed(5)  # noqa: NPY002
    assert run(case.campaign(max_calls=40), case.crash) == first


def test_replaying_outcomes_reproduces_the_campaign(case):
    first = case.campaign(max_calls=60)
    got = run(first, case.crash)
    outcomes = iter(first.outcomes)
    again = case.campaign(max_calls=60)
    assert run(again, lambda x: [next(outcomes) for _ in x]) == got


def test_history_is_of_every_batch(case):
    campaign, counts = case.campaign(max_calls=70), []
    while not campaign.done:
        campaign.tell(case.crash(campaign.ask()))
        counts.append(campaign.n_calls)
    got = campaign.estimate()
    assert [h.n_calls for h in got.history] == counts
    last = got.history[-1]
    assert (last.probability, last.lower, last.upper) == (got.probability, *got.interval)


@pytest.mark.parametrize("first", [1, 2])
def test_budget_is_never_exceeded(case, first):
    for max_calls in range(first, 61, 2):
        campaign = case.campaign(max_calls=max_calls, relative_half_width=1e-6)
        got = run(campaign, case.crash)
        assert got.n_calls == max_calls
        assert got.stop_reason is StopReason.BUDGET_ENDED
        assert Alarm.TARGET_NOT_REACHED in got.alarms


@pytest.mark.parametrize("batch_size", [1, 2, 3, 37, 100])
@pytest.mark.parametrize("max_calls", [1, 13, 43, 59])
def test_budget_is_never_exceeded_whatever_the_batch(case, batch_size, max_calls):
    asked = []

    def simulate(x):
        asked.append(len(x))
        return case.crash(x)

    got = run(case.campaign(max_calls=max_calls, batch_size=batch_size), simulate)
    assert got.n_calls == sum(asked) <= max_calls
    assert max(asked) <= batch_size


def test_budget_without_an_order(case):
    for max_calls in (1, 7, 30, 55):
        got = run(case.campaign(risk=None, max_calls=max_calls), case.crash)
        assert got.n_calls <= max_calls
        assert Alarm.NO_ORDER in got.alarms or not got.probability > 0


def test_failed_simulations_are_said_and_widen_the_interval(case):
    whole = run(case.campaign(max_calls=120, relative_half_width=0.01), case.crash)
    numbers = iter(range(10**6))

    def simulate(x):
        failed = np.array([next(numbers) % 8 == 7 for _ in x])
        return np.where(failed, np.nan, case.crash(x))

    got = run(case.campaign(max_calls=120, relative_half_width=0.01), simulate)
    assert got.n_failed == 15
    assert Alarm.SIMULATIONS_FAILED in got.alarms
    assert Alarm.SIMULATIONS_FAILED not in whole.alarms
    assert got.interval[0] <= 1e-2 <= got.interval[1]
    assert got.half_width > whole.half_width


def test_a_simulator_that_only_fails_is_given_up(case):
    got = run(case.campaign(max_calls=60), lambda x: np.full(len(x), np.nan))
    assert got.n_failed == got.n_calls == 20
    assert got.stop_reason is StopReason.ALL_FAILED
    assert got.interval == (0.0, 1.0)
    assert got.alarms == (Alarm.ALL_FAILED,)
    assert "all 20 simulations failed" in got.sentence()


def test_estimate_is_the_loop_over_ask_and_tell(case):
    seen = []
    got = crashrate.estimate(
        case.crash,
        case.traffic,
        risk=case.risk,
        seed=1,
        max_calls=50,
        on_batch=lambda c: seen.append(c.n_calls),
    )
    assert got == run(case.campaign(seed=1, max_calls=50), case.crash)
    assert seen == [h.n_calls for h in got.history]


def test_estimate_without_an_order(case):
    got = crashrate.estimate(case.crash, case.traffic, max_calls=150, relative_half_width=0.3)
    assert got.interval[0] <= 1e-2 <= got.interval[1]
    assert got.bounds == (0.0, 1.0)
    assert Alarm.NO_ORDER in got.alarms


def test_a_simulator_that_returns_something_else(case):
    with pytest.raises(InvalidInputError, match="expected 1 outcome, for 1 situation"):
        crashrate.estimate(lambda x: np.zeros((len(x), 2)), case.traffic, risk=case.risk)


def test_what_a_simulator_raises_comes_with_where(case):
    calls = iter(range(100))

    def simulate(x):
        if next(calls) == 3:
            raise ZeroDivisionError("in the vehicle")
        return case.crash(x)

    with pytest.raises(ZeroDivisionError, match="in the vehicle") as raised:
        crashrate.estimate(simulate, case.traffic, risk=case.risk)
    (note,) = raised.value.__notes__
    assert "after 3 outcomes, at situations of shape (1, 2)" in note


def test_arguments_in_another_order(case):
    with pytest.raises(InvalidInputError, match="got TrafficModel; the traffic model comes second"):
        crashrate.estimate(case.traffic, case.crash)
    with pytest.raises(InvalidInputError, match=r"simulate: expected a function.*got int"):
        crashrate.estimate(3, case.traffic)
    with pytest.raises(InvalidInputError, match=r"risk: expected a mapping .*got str"):
        crashrate.estimate(case.crash, case.traffic, risk="increasing")


def test_a_target_above_one_is_none(case):
    with pytest.raises(InvalidInputError, match=r"up to 1 .*got 10"):
        case.campaign(relative_half_width=10)


def test_derived_coordinates_as_function_and_as_expression(case):
    names = case.traffic.names
    derived = {
        "function": (lambda x: x[:, 0] + x[:, 1], "increasing"),
        "expression": (Expression("a + b", names), "increasing"),
        "negative": (lambda x: -(x[:, 0] + x[:, 1]), "decreasing"),
    }
    got = {name: case.estimate(risk={"total": how}, max_calls=80) for name, how in derived.items()}
    assert got["function"].history == got["negative"].history
    # of a formula the bounds are exact, and an estimate beside them is moved in at the end
    assert got["function"].history[:-1] == got["expression"].history[:-1]
    assert got["function"].probability == pytest.approx(got["expression"].probability, rel=0.01)
    assert got["function"].interval[0] <= 1e-2 <= got["function"].interval[1]
    assert got["function"].relative_half_width < 0.1


def test_confidence_is_that_of_the_interval(case):
    wide, narrow = (case.estimate(confidence=c, max_calls=70) for c in (0.99, 0.8))
    assert wide.confidence == 0.99
    assert wide.relative_half_width > narrow.relative_half_width


def test_what_campaign_shows_of_itself(case):
    campaign = Campaign(case.traffic, risk=case.risk, seed=2)
    assert campaign.method == "sequential"
    assert campaign.problem.seed == 2
    assert campaign.x.shape == (0, 2)
    campaign.tell(case.crash(campaign.ask()))
    assert campaign.x.shape == (1, 2)
    assert campaign.snapshot.learned is not None
