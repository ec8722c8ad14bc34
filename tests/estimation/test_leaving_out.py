"""A variable in no risk coordinate is claimed not to matter: the claim is tested."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from crashrate.crash_set.order import RiskOrder
from crashrate.estimation import leaving_out
from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.estimation.labels import Labels
from crashrate.estimation.leaving_out import check_contradicted, check_left_out
from crashrate.estimation.run import estimate
from crashrate.estimation.strategy import Problem, Snapshot
from crashrate.expressions import Expression

LEVEL, ALONE = 5.2, 3.6
SEEN, UNSEEN = norm.sf(LEVEL / np.sqrt(2)), norm.sf(ALONE)
P = SEEN + UNSEEN - SEEN * UNSEEN
RISK = {"a": "increasing", "b": "increasing"}


def by_two(x):
    return x[:, 0] + x[:, 1] >= LEVEL


def by_the_third_too(x):
    return by_two(x) | (x[:, 2] >= ALONE)


def found(cases, crash, seed, **options):
    options = {"risk": RISK, "relative_half_width": 0.25, "max_calls": 500} | options
    return estimate(crash, cases.standard_normal(3), seed=seed, **options)


@pytest.mark.parametrize(("risk", "n"), [(RISK, 1), (RISK | {"c": "decreasing"}, 0), (None, 0)])
def test_a_problem_knows_what_its_order_leaves_out(cases, risk, n):
    traffic = cases.standard_normal(3)
    order = None if risk is None else RiskOrder.from_mapping(risk, traffic.names)
    blind = Problem(traffic=traffic, order=order).blind
    assert blind is None if n == 0 else blind.n == n


def test_a_variable_that_decides_outcomes_is_found_and_looked_at(cases, check_coverage):
    studies = [found(cases, by_the_third_too, seed) for seed in range(3)]
    check_coverage([s.interval for s in studies], P)
    for study in studies:
        assert study.stop_reason is StopReason.TARGET_MET
        assert {Alarm.LEFT_OUT_MATTERS, Alarm.ORDER_DROPPED, Alarm.NO_ORDER} <= set(study.alarms)


def test_unless_it_is_tested_half_the_probability_is_lost(cases, monkeypatch):
    monkeypatch.setattr(leaving_out, "N_ALONE", 0)
    for seed in range(2):
        study = found(cases, by_the_third_too, seed)
        assert study.interval[1] < 0.6 * P
        assert study.stop_reason is StopReason.TARGET_MET
        assert study.alarms == (Alarm.LEFT_OUT_UNTESTED,)


BEYOND = 4.2 * np.sqrt(2)
SUM = {"sum": (Expression("a + b", ("a", "b")), "increasing")}


@pytest.mark.parametrize(
    ("risk", "crash", "p"),
    [
        (SUM, lambda x: np.abs(x[:, 1]) > BEYOND - x[:, 0], 1 - norm.cdf(4.2) ** 2),
        # the only coordinate has one most dangerous place, and the rim of what is looked at is near
        ({"a": "increasing"}, lambda x: x.max(axis=1) > 4.2, 1 - norm.cdf(4.2) ** 2),
    ],
)
def test_a_direction_that_one_coordinate_does_not_see_is_looked_along(
    cases, check_coverage, risk, crash, p
):
    options = {"risk": risk, "relative_half_width": 0.25, "max_calls": 500}
    studies = [estimate(crash, cases.standard_normal(2), seed=s, **options) for s in range(3)]
    check_coverage([s.interval for s in studies], p)
    assert all(Alarm.LEFT_OUT_MATTERS in s.alarms for s in studies)


def test_the_far_side_of_one_component_lies_inside_all_of_traffic(cases, check_coverage):
    """Between two components, above the one: not far out of the whole along any direction."""
    one = cases.standard_normal(2)
    both = replace(
        one,
        weights=[0.5, 0.5],
        means=[[0.0, 0.0], [0.0, 40.0]],
        covariances=np.repeat(one.covariances, 2, axis=0),
    )
    crash = lambda x: (x[:, 0] > 4.2) | ((x[:, 1] > 4.2) & (x[:, 1] < 10))  # noqa: E731
    p = 1 - norm.cdf(4.2) * (1 - norm.sf(4.2) / 2)
    options = {"risk": {"a": "increasing"}, "relative_half_width": 0.25, "max_calls": 500}
    studies = [estimate(crash, both, seed=s, **options) for s in range(2)]
    check_coverage([s.interval for s in studies], p)
    assert all(Alarm.LEFT_OUT_MATTERS in s.alarms for s in studies)


def test_ripples_along_what_an_order_does_not_see_cost_no_order(cases):
    level = 4.2 * np.sqrt(2)
    phases = np.sin(np.linspace(0, 2 * np.pi, 401)[:-1])
    p = norm.sf((level - 0.1 * phases) / np.sqrt(2)).mean()
    study = found(cases, lambda x: x[:, 0] + x[:, 1] + 0.1 * np.sin(40 * x[:, 2]) > level, 3)
    assert Alarm.LEFT_OUT_MATTERS not in study.alarms
    assert study.interval[0] <= p <= study.interval[1]


def test_a_budget_that_ends_before_the_test_says_so(cases):
    short = found(cases, by_two, 0, max_calls=60)
    assert Alarm.LEFT_OUT_UNTESTED in short.alarms
    bounds = found(cases, by_two, 0, goal="bounds", max_calls=25)
    assert Alarm.LEFT_OUT_UNTESTED in bounds.alarms
    whole = found(cases, by_two, 0)
    assert Alarm.LEFT_OUT_UNTESTED not in whole.alarms
    all_seen = found(cases, by_two, 0, risk=RISK | {"c": "increasing"}, max_calls=60)
    assert Alarm.LEFT_OUT_UNTESTED not in all_seen.alarms


def test_where_nothing_is_held_safe_far_out_the_answer_says_so(cases, monkeypatch):
    nothing = np.empty((0, 3)), np.empty((0, 2))
    monkeypatch.setattr(leaving_out, "_safe_by_order", lambda *_: nothing)
    study = found(cases, by_two, 0)
    assert study.stop_reason is StopReason.TARGET_MET
    assert Alarm.LEFT_OUT_UNTESTED in study.alarms


def test_two_variables_that_only_matter_together_are_looked_at_together(cases):
    crash = lambda x: (x[:, 0] > 4.3) | (x[:, 1:].min(axis=1) > 2.7)  # noqa: E731
    p = 1 - norm.cdf(4.3) * (1 - norm.sf(2.7) ** 2)
    study = found(cases, crash, 0, risk={"a": "increasing"}, relative_half_width=0.3)
    assert Alarm.LEFT_OUT_MATTERS in study.alarms
    assert study.interval[0] <= p <= study.interval[1]


def test_one_that_does_not_matter_costs_the_looks_and_no_order(cases):
    study = found(cases, by_two, 0)
    assert study.interval[0] <= SEEN <= study.interval[1]
    assert not set(study.alarms) & {Alarm.LEFT_OUT_MATTERS, Alarm.ORDER_DROPPED}
    assert study.n_calls < 120


def test_one_that_adds_to_danger_costs_the_order_by_contradictions(cases):
    p = norm.sf(7 / np.sqrt(3))
    study = found(cases, lambda x: x.sum(axis=1) >= 7, 0)
    assert study.interval[0] <= p <= study.interval[1]
    assert study.stop_reason is StopReason.TARGET_MET
    assert Alarm.LEFT_OUT_MATTERS in study.alarms


def test_bounds_are_not_given_where_it_matters(cases):
    study = found(cases, by_the_third_too, 1, goal="bounds", relative_half_width=0.3)
    assert study.stop_reason is StopReason.ORDER_DROPPED
    assert study.bounds == (0.0, 1.0)
    assert Alarm.LEFT_OUT_MATTERS in study.alarms
    kept = found(cases, by_two, 1, goal="bounds", relative_half_width=0.3)
    assert kept.stop_reason is StopReason.TARGET_MET
    assert kept.bounds[0] <= SEEN <= kept.bounds[1]


@pytest.fixture
def problem(cases):
    traffic = cases.standard_normal(3)
    return Problem(traffic=traffic, order=RiskOrder.from_mapping(RISK, traffic.names))


@pytest.fixture
def labels(problem):
    """A crash, and safe runs along an edge below it."""
    along = np.linspace(-2.0, 2.0, 9)
    safe = np.stack([2 + along, 2 - along, 0 * along], axis=1)
    crash = np.array([[2.7, 2.7, 0.0]])
    return Labels.empty(problem).add(np.concatenate([crash, safe]), np.array([1.0] + [0.0] * 9))


def looked(problem, labels, simulate, drive):
    steps = check_left_out(problem, labels, np.ones(2), np.random.default_rng(0), Snapshot())
    return drive(steps, lambda x: simulate(x).astype(float))


def test_runs_are_safe_by_the_order_and_far_out(problem, labels, drive):
    (told, whole), queries = looked(problem, labels, lambda x: np.zeros(len(x)), drive)
    x = np.concatenate([query.x for query in queries])
    assert told.order is problem.order
    assert whole
    assert len(x) == 2 * len(leaving_out.FAR_OUT) * leaving_out.N_ALONE
    assert labels.implied(labels.coordinates(x))[1].all()
    assert np.count_nonzero(x[:, 2] > 0) == len(x) / 2
    assert (np.abs(x[:, 2]) > 1.5).all()


def test_a_crash_with_the_variable_as_usual_too_refutes_other_claims(problem, labels, drive):
    (told, _), queries = looked(problem, labels, lambda x: x[:, 0] > 1, drive)
    assert told.learned is not None
    assert told.contradictions > 0
    asked = queries[-1].x
    np.testing.assert_allclose(asked[:, 2], 0.0, atol=1e-12)
    (told, _), _ = looked(problem, labels, lambda x: (x[:, 0] > 1) & (x[:, 2] > 1), drive)
    assert told.learned is None
    assert told.order is None
    np.testing.assert_array_equal(told.u, told.x)


def test_an_outcome_that_contradicts_has_a_twin_as_usual(problem, labels, drive):
    """Found by chance: a crash below a safe outcome, with the variable far out."""
    odd = np.array([[1.5, 1.5, 2.5]])
    contradicted = labels.add(odd, np.array([1.0]))

    def tested(simulate, labels=contradicted):
        steps = check_contradicted(problem, labels, np.ones(2), Snapshot())
        return drive(steps, lambda x: simulate(x).astype(float))

    told, queries = tested(lambda x: x[:, 2] > 1)
    np.testing.assert_allclose(queries[0].x, [[1.5, 1.5, 0.0]], atol=1e-12)
    assert told.order is None
    told, queries = tested(lambda x: np.ones(len(x)))  # the order is wrong, not what it leaves out
    assert told.order is problem.order
    assert tested(np.isnan, told)[1] == []  # not again
    assert tested(lambda x: np.full(len(x), np.nan))[0].order is problem.order
    assert tested(np.isnan, labels)[1] == []


def test_without_equal_coordinates_a_twin_is_no_less_dangerous(cases):
    traffic = cases.standard_normal(2)
    product = (lambda x: np.hypot(x[:, 0], x[:, 1]), "increasing")
    problem = Problem(traffic=traffic, order=RiskOrder.from_mapping({"r": product}, traffic.names))
    labels, x = Labels.empty(problem), traffic.sample(500, 1)
    twins = leaving_out._twins(problem, labels, x, labels.coordinates(x), x[:5])
    assert len(twins) == 5
    assert (labels.coordinates(twins) >= labels.coordinates(x[:5])).all()
    assert not (twins == x[:5]).all(axis=1).any()
    assert len(leaving_out._twins(problem, labels, x[:0], x[:0, :1], x[:5])) == 0


@pytest.mark.parametrize(("k", "n_looks"), [(1, 6), (2, 24), (3, 30), (4, 36), (8, 44)])
def test_looks_go_along_unit_ways_and_their_number_is_bounded(k, n_looks):
    looks = leaving_out._looks(k, np.random.default_rng(0))
    assert len(looks) == n_looks
    np.testing.assert_allclose([np.linalg.norm(way) for way, _, _ in looks], 1.0)


def test_failed_runs_refute_nothing(problem, labels, drive):
    (told, whole), _ = looked(problem, labels, lambda x: np.full(len(x), np.nan), drive)
    assert told.learned is not None
    assert whole


def test_a_failed_run_as_usual_clears_nothing(problem, labels, drive):
    def simulate(x):
        return np.where(np.abs(x[:, 2]) < 1e-9, np.nan, x[:, 2] > 1)

    assert looked(problem, labels, simulate, drive)[0][0].order is None


def test_what_the_budget_cuts_short_is_said(problem, labels, drive):
    short = replace(problem, max_calls=labels.n + 5)
    (told, whole), _ = looked(short, labels, lambda x: np.zeros(len(x)), drive)
    assert told.n == labels.n + 5
    assert not whole


@pytest.mark.parametrize("risk", [RISK, {"a": "increasing"}])
def test_an_order_given_up_among_failed_runs_or_at_the_end_leaves_an_answer(cases, risk):
    """Coordinates change under a pool that was seen by others."""

    def simulate(x):
        return np.where(np.abs(x[:, 1] + 2) < 0.1, np.nan, by_the_third_too(x))

    for max_calls in (60, 85, 100):
        study = found(cases, simulate, 0, risk=risk, max_calls=max_calls)
        assert study.n_calls == max_calls
        unchecked = {Alarm.TARGET_UNCHECKED, Alarm.TARGET_NOT_REACHED} & set(study.alarms)
        assert unchecked or study.interval[0] <= P <= study.interval[1]


def test_a_target_whose_test_was_cut_short_is_not_met(cases):
    whole = found(cases, by_two, 0)
    assert whole.stop_reason is StopReason.TARGET_MET
    cut = found(cases, by_two, 0, max_calls=whole.n_calls - 8)
    assert cut.stop_reason is StopReason.BUDGET_ENDED
    assert Alarm.TARGET_UNCHECKED in cut.alarms
