"""Every alarm: a case that raises it and one that does not."""

from dataclasses import replace

import numpy as np
import pytest

from crashrate.crash_set.order import RiskOrder
from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.estimation.answer import doubts
from crashrate.estimation.campaign import _alarms
from crashrate.estimation.consequence import Consequence
from crashrate.estimation.hits import Hits
from crashrate.estimation.labels import Labels
from crashrate.estimation.rounds import Round, combine
from crashrate.estimation.state import State
from crashrate.estimation.strategy import Problem, Snapshot

CALM = [
    Round(
        n_runs=10,
        estimate=1e-3 + e,
        lowest=1e-3 + e,
        highest=1e-3 + e,
        predicted=1e-3,
        known=1e-3,
        variance=1e-8,
        squares=1e-8,
        largest=1e-5,
        hits=Hits(n=1, reach=1e3),
    )
    for e in (-1e-4, 1e-4, -1e-4, 1e-4)
]
BOUNDS = (5e-4, 2e-3)


@pytest.fixture
def problem(cases):
    order = RiskOrder.from_mapping(cases.increasing(2), ("a", "b"))
    return Problem(traffic=cases.standard_normal(2), order=order)


def raised(problem, rounds=CALM, bounds=BOUNDS, labels=None, *, dropped=False, surprised=False):
    labels = Labels.empty(problem) if labels is None else labels
    state = State(
        labels,
        np.empty((0, 2)),
        problem.traffic,
        None,
        rounds=tuple(rounds),
        dropped_at=5 if dropped else None,
        surprised=surprised,
    )
    combined = combine(rounds, 0.95) if rounds else None
    return doubts(problem, state, combined, bounds)


def test_no_alarm_without_reason(problem):
    assert raised(problem) == ()
    assert raised(problem, rounds=[]) == ()


def test_weights_concentrated(problem):
    rounds = [replace(CALM[0], largest=2e-3), *CALM[1:]]
    assert raised(problem, rounds) == (Alarm.WEIGHTS_CONCENTRATED,)


def test_scatter_beyond_prediction(problem):
    rounds = [replace(r, estimate=1e-3 + 3 * (r.estimate - 1e-3)) for r in CALM]
    assert raised(problem, rounds) == (Alarm.SCATTER_BEYOND_PREDICTION,)


def test_too_few_hits(problem):
    none = [replace(r, hits=Hits(reach=1e2)) for r in CALM]
    assert raised(problem, none) == (Alarm.TOO_FEW_CRASHES,)
    far_reaching = [replace(r, hits=Hits(reach=1e6)) for r in CALM]
    assert raised(problem, far_reaching) == ()


def test_unsettled(problem):
    moves = [replace(CALM[0], predicted=1e-2), *CALM[1:]]
    assert raised(problem, moves) == (Alarm.UNSETTLED,)
    moved = [replace(CALM[0], predicted=1e-2), *CALM, *CALM]
    assert raised(problem, moved) == ()
    wide = [replace(r, variance=2e-6, squares=2e-6, hits=Hits(n=1, reach=1e2)) for r in CALM]
    assert raised(problem, wide, bounds=(5e-4, 0.04)) == (Alarm.UNSETTLED,)


def test_crashes_unforeseen(problem):
    assert raised(problem, surprised=True) == (Alarm.OUTCOMES_UNFORESEEN,)


def test_undecided_mass_large(problem):
    assert raised(problem, bounds=(0.0, 0.06)) == (Alarm.UNDECIDED_MASS_LARGE,)
    assert raised(problem, bounds=(0.0, 0.04)) == ()


def test_order_contradicted(problem):
    x, y = np.array([[0.0, 0.0], [1.0, 1.0]]), np.array([1.0, 0.0])
    labels = Labels.empty(problem).add(x, y)
    assert raised(problem, labels=labels) == (Alarm.ORDER_CONTRADICTED,)
    assert raised(problem, labels=Labels.empty(problem).add(x, 1 - y)) == ()


def test_order_dropped(problem):
    labels = Labels.empty(problem).without_order()
    got = raised(problem, labels=labels, dropped=True)
    assert got == (Alarm.ORDER_DROPPED, Alarm.NO_ORDER)


def test_no_order(cases):
    assert raised(Problem(traffic=cases.standard_normal(2))) == (Alarm.NO_ORDER,)


SEEN = Snapshot(probability=0.1)
ENDED = replace(SEEN, stop_reason=StopReason.BUDGET_ENDED)
TURNED_ROUND = (Alarm.NEARLY_ALL_CRASH, Alarm.NO_ORDER)  # what is worse comes first
INJURY = Consequence(
    name="injury",
    mean=0.05,
    interval=(0.03, 0.07),
    standard_error=0.01,
    n_eff=25.0,
    n_carrying=10,
    largest_weight_share=0.1,
)


@pytest.mark.parametrize(
    ("snapshot", "crashes", "failed", "expected"),
    [
        (SEEN, 10, 0, ()),
        (SEEN, 9, 0, (Alarm.TOO_FEW_CRASHES,)),
        (Snapshot(), 9, 0, ()),
        (SEEN, 0, 0, ()),
        (SEEN, 10, 1, (Alarm.SIMULATIONS_FAILED,)),
        (ENDED, 10, 0, (Alarm.TARGET_NOT_REACHED,)),
        (
            replace(ENDED, alarms=(Alarm.TARGET_UNCHECKED,)),  # as the method says where it is so
            10,
            0,
            (Alarm.TARGET_UNCHECKED,),
        ),
        (replace(SEEN, stop_reason=StopReason.TARGET_MET), 10, 0, ()),
        (Snapshot(probability=0.95), 10, 0, (Alarm.NEARLY_ALL_CRASH,)),
        (Snapshot(probability=0.6), 10, 0, ()),
        (replace(SEEN, alarms=(Alarm.NO_ORDER,), probability=0.95), 10, 0, TURNED_ROUND),
        (replace(SEEN, consequences=(INJURY,)), 10, 0, ()),
        (
            replace(SEEN, consequences=(INJURY, replace(INJURY, n_carrying=9))),
            10,
            0,
            (Alarm.CONSEQUENCE_UNDETERMINED,),
        ),
        (
            replace(SEEN, consequences=(replace(INJURY, n_eff=4.9), INJURY)),
            10,
            0,
            (Alarm.CONSEQUENCE_UNDETERMINED,),
        ),
        (
            replace(SEEN, consequences=(replace(INJURY, interval=(0.0, 0.06)),)),
            10,
            0,
            (Alarm.CONSEQUENCE_UNDETERMINED,),
        ),
        (replace(SEEN, consequences=(replace(INJURY, interval=(0, 0.06), aimed=True),)), 10, 0, ()),
        (
            replace(SEEN, consequences=(replace(INJURY, largest_weight_share=0.3, aimed=True),)),
            10,
            0,
            (Alarm.CONSEQUENCE_UNDETERMINED,),
        ),
    ],
)
def test_alarms_of_the_outcomes(snapshot, crashes, failed, expected):
    y = np.concatenate([np.ones(crashes), np.zeros(5), np.full(failed, np.nan)])
    assert _alarms(snapshot, y) == expected


def test_all_failed():
    assert _alarms(Snapshot(), np.full(3, np.nan)) == (Alarm.ALL_FAILED,)
    assert _alarms(Snapshot(), np.empty(0)) == ()


def test_no_crash_found(cases, small):  # noqa: ARG001
    never = cases.never(cases.increasing(2)).estimate(max_calls=30)
    assert never.alarms == (Alarm.NO_CRASH_FOUND, Alarm.TARGET_NOT_REACHED)
    often = cases.half_plane(0.1).estimate(max_calls=100, relative_half_width=0.5)
    assert often.alarms == ()


def test_messages_are_sentences_of_their_own():
    assert len({a.value for a in Alarm}) == len(Alarm)
    assert all(len(a.value) > 20 for a in Alarm)
