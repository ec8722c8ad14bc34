"""Goal "bounds": brackets that hold where the order does, and say so where it does not."""

import numpy as np
import pytest
from scipy.stats import norm

from crashrate.errors import InvalidInputError
from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.traffic.model import TrafficModel


@pytest.fixture(autouse=True)
def small_pools(small, monkeypatch):  # noqa: ARG001
    from crashrate.estimation import auditing, bracket, gap

    for module, name, value in (
        (bracket, "N_POOL", 3000),
        (bracket, "N_LAST", 20_000),
        (auditing, "N_POOL", 3000),
        (gap, "N_SEEN", 300),
        (gap, "N_CANDIDATES", 300),
        (gap, "N_MASS", 1500),
        (gap, "N_FIT", 150),
        (gap, "N_COMPONENTS", 4),
    ):
        monkeypatch.setattr(module, name, value)


def bounds(case, **options):
    return case.estimate(**{"goal": "bounds", "relative_half_width": 1e-3} | options)


def holds(got, case):
    return got.bounds[0] <= case.probability <= got.bounds[1]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("shape", "d", "factor"), [("half_plane", 2, 2.2), ("orthant", 2, 1.2), ("half_plane", 3, 200)]
)
def test_bounds_hold_and_come_close(cases, shape, d, factor, seed):
    case = getattr(cases, shape)(1e-6, d)
    got = bounds(case, seed=seed, max_calls=120)
    assert holds(got, case)
    assert got.bounds_factor < factor
    assert got.n_calls <= 120
    assert Alarm.ORDER_CONTRADICTED not in got.alarms


@pytest.mark.parametrize("seed", range(3))
def test_bounds_that_must_be_drawn_hold_too(cases, seed):
    case = cases.half_plane(1e-4, 4)
    got = bounds(case, seed=seed, max_calls=90)
    assert holds(got, case)
    assert got.bounds[0] > 0


def test_they_come_closer_than_those_of_an_estimate(cases):
    case = cases.half_plane(1e-5)
    own = [bounds(case, seed=seed, max_calls=100) for seed in range(4)]
    other = [case.estimate(seed, relative_half_width=1e-3, max_calls=100) for seed in range(4)]
    ratio = [a.bounds_factor / b.bounds_factor for a, b in zip(own, other, strict=True)]
    assert np.mean(ratio) < 0.8
    assert np.max(ratio) < 1


def test_no_estimate_and_no_interval_are_claimed(cases):
    got = bounds(cases.half_plane(1e-5), max_calls=60)
    assert np.isnan(got.probability)
    assert got.interval == (0.0, 1.0)
    assert got.goal == "bounds"
    assert got.sentence().startswith("bounds if the risk order holds: ")
    assert got.order_audit is not None


def test_target_is_half_the_bracket_over_its_middle(cases):
    got = bounds(cases.half_plane(1e-4), max_calls=400, relative_half_width=0.2)
    low, high = got.bounds
    assert got.stop_reason is StopReason.TARGET_MET
    assert high - low <= 0.2 * (high + low)
    assert got.n_calls < 200
    assert got.order_audit.n_crash + got.order_audit.n_safe >= 0.08 * got.n_calls


def test_one_coordinate_is_bisected(cases):
    case = cases.tail(1e-6)
    got = bounds(case, max_calls=150)
    assert holds(got, case)
    assert got.bounds_factor < 1.01


def test_slabs_beside_the_box_are_closed(monkeypatch):
    from crashrate.estimation import gap
    from crashrate.estimation.run import estimate

    # the second variable changes nothing: only a safe run on its bound closes the slab beside it
    traffic = TrafficModel([1.0], [[0.0, 1.0]], [np.eye(2)], [-np.inf, 0], [np.inf] * 2, ("a", "b"))

    def factor():
        risk = {"a": "increasing", "b": "decreasing"}
        level = norm.isf(1e-6)
        return estimate(
            lambda x: x[:, 0] >= level,
            traffic,
            risk=risk,
            goal="bounds",
            max_calls=90,
            relative_half_width=1e-4,
        ).bounds_factor

    with_bounds = factor()
    monkeypatch.setattr(gap, "MOVED", 0.0)
    assert with_bounds < 0.5 * factor()


# --- an order that is false


def test_an_order_that_is_wrong_altogether_is_dropped(cases):
    got = bounds(cases.disc(risk=cases.increasing(2)), max_calls=200)
    assert got.stop_reason is StopReason.ORDER_DROPPED
    assert got.bounds == (0.0, 1.0)
    assert Alarm.ORDER_DROPPED in got.alarms
    assert "the risk order was dropped" in got.sentence()


def pocketed(cases, p=1e-4):
    """A half-plane with safe situations behind its edge: what it holds, exactly."""
    whole = cases.half_plane(p)
    level, depth, (left, right) = norm.isf(p), 0.15, (-1.0, 0.3)

    def crash(x):
        along, across = (x[:, 0] - x[:, 1]) / np.sqrt(2), x.sum(axis=1) / np.sqrt(2)
        hollow = (across > level + depth) & (left < along) & (along < right)
        return whole.crash(x) & ~hollow

    lost = norm.sf(level + depth) * (norm.cdf(right) - norm.cdf(left))
    return crash, whole, p - lost


@pytest.mark.parametrize("seed", range(4))
def test_an_order_false_behind_the_edge_is_contradicted_and_what_is_left_holds(cases, seed):
    crash, whole, p = pocketed(cases)
    got = type(whole)(whole.traffic, crash, p, whole.risk).estimate(
        seed=seed, goal="bounds", max_calls=150, relative_half_width=1e-3
    )
    assert {Alarm.ORDER_CONTRADICTED, Alarm.ORDER_DROPPED} & set(got.alarms)
    if got.order_audit is not None:
        assert got.order_audit.least(got.bounds) <= p


def test_without_an_order_it_is_refused(cases):
    case = cases.half_plane(1e-3)
    with pytest.raises(InvalidInputError, match=r"'bounds' needs a risk order"):
        bounds(case, risk=None)


# --- budgets, failures, replay


@pytest.mark.parametrize("max_calls", [1, 7, 33, 41, 64])
def test_budget_is_never_exceeded(cases, max_calls):
    got = bounds(cases.half_plane(1e-3), max_calls=max_calls)
    assert got.n_calls <= max_calls
    assert got.stop_reason is StopReason.BUDGET_ENDED


def test_failed_simulations_leave_bounds_that_hold(cases):
    case = cases.half_plane(1e-4)
    numbers = iter(range(10**6))

    def simulate(x):
        failed = np.array([next(numbers) % 7 == 6 for _ in x])
        return np.where(failed, np.nan, case.crash(x))

    got = bounds(type(case)(case.traffic, simulate, 1e-4, case.risk), max_calls=120)
    assert holds(got, case)
    assert got.bounds_factor < 4
    assert Alarm.SIMULATIONS_FAILED in got.alarms


def test_a_place_that_always_fails_does_not_take_the_budget(cases):
    case = cases.half_plane(1e-4)

    def simulate(x):
        return np.where(x[:, 0] > x[:, 1] + 2.0, np.nan, case.crash(x))

    got = bounds(type(case)(case.traffic, simulate, 1e-4, case.risk), max_calls=120)
    assert holds(got, case)
    assert got.n_failed < 60


def told(campaign, simulate):
    while not campaign.done:
        campaign.tell(simulate(campaign.ask()))
    return campaign


def test_equal_bits_for_the_same_seed(cases):
    case = cases.half_plane(1e-4)
    one, same = (told(case.campaign(goal="bounds", max_calls=70), case.crash) for _ in range(2))
    assert one.estimate() == same.estimate()
    assert np.array_equal(one.x, same.x)


def test_a_raised_budget_goes_on_after_the_audit(cases):
    case = cases.half_plane(1e-4)
    options = {"goal": "bounds", "relative_half_width": 1e-3}
    first = told(case.campaign(max_calls=70, **options), case.crash)
    raised = case.campaign(max_calls=110, earlier_budgets=[(70, 70)], **options)
    more = told(raised, case.crash)
    assert np.array_equal(more.x[:70], first.x)
    assert more.n_calls == 110
    assert more.estimate().bounds_factor < first.estimate().bounds_factor
    # without that memory it would have asked for others where the audit was
    forgetful = told(case.campaign(max_calls=110, **options), case.crash)
    assert not np.array_equal(forgetful.x[:70], first.x)


def test_what_was_learned_can_be_asked(cases):
    campaign = told(
        cases.half_plane(1e-3).campaign(goal="bounds", max_calls=60), cases.half_plane(1e-3).crash
    )
    h = campaign.crash_probability([[5.0, 5.0], [0.0, 0.0]])
    assert h[0] > 0.99
    assert h[1] < 0.01
