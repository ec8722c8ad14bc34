"""All parts together, on events drawn from a known law: quiet where the model is right."""

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

from crashrate.estimation.alarms import Alarm
from crashrate.estimation.traffic_range import TrafficRange
from crashrate.recordings.check import Check, check, n_duplicates
from crashrate.recordings.near_misses import Quantity
from crashrate.recordings.replay import Replay

N = 20_000
P = norm.sf(4.5)
QUANTITIES = (Quantity("a", "", lambda x: x[:, 0], 1.0),)
ANSWER = SimpleNamespace(probability=P, interval=(0.9 * P, 1.1 * P), traffic_range=None, alarms=())


def found(known, model, seed=0, replay=None):
    events = known["normal"]().sample(N, seed)
    said = []
    got = check(
        known["comparison"](model, events, seed), QUANTITIES, replay or Replay(N, 10, 0, 0, ()),
        said.append,
    )  # fmt: skip
    assert len(said) == 6
    assert got.failed == {}
    return got


@pytest.fixture(scope="module")
def right(known):
    return found(known, known["normal"]())


@pytest.fixture(scope="module")
def heavy(known):
    return found(known, known["normal"](0.0, 1.15))


def test_nothing_is_raised_where_the_model_is_right(right):
    assert right.alarms(ANSWER) == ()
    assert right.ladder.p_value > 0.01
    assert right.extremes.interval[0] < P < right.extremes.interval[1]


def test_expectation_is_exact(right):
    exact = N * norm.sf(4.5 / np.array(right.ladder.levels))
    assert right.ladder.expected == pytest.approx(exact, rel=0.03)


def test_a_tail_too_heavy_is_seen_on_the_ladder(heavy):
    assert Alarm.TAIL_MISFIT in heavy.alarms(ANSWER)


def test_near_misses_raise_an_alarm_where_the_model_misses_them(right, heavy):
    assert not any(tail.misfit for tail in right.tails)
    assert Alarm.NEAR_MISSES_DISAGREE in heavy.alarms(ANSWER)


def test_events_that_leave_the_number_wide_open_raise_an_alarm(right):
    """Also where no further fits say so."""
    assert right.influential.relative_error < 0.7
    assert Alarm.TRAFFIC_UNDETERMINED not in right.alarms(ANSWER)
    open_wide = replace(right, influential=replace(right.influential, relative_error=2.6))
    assert "a factor 72.0 either way" in open_wide.sentences(ANSWER)[1]
    assert Alarm.TRAFFIC_UNDETERMINED in open_wide.alarms(ANSWER)
    # where there is no number yet, nothing moves it
    none = SimpleNamespace(probability=math.nan, interval=(0.0, 1.0), traffic_range=None, alarms=())
    assert open_wide.sentences(none) == [open_wide.replay.sentence()]
    assert Alarm.TRAFFIC_UNDETERMINED not in open_wide.alarms(none)


def test_an_answer_that_events_exclude_is_seen(right):
    answer = SimpleNamespace(
        probability=0.015, interval=(0.01, 0.02), traffic_range=None, alarms=()
    )
    right = replace(right, ladder=None)
    raised = right.alarms(answer)
    assert {Alarm.REPLAY_DISAGREES, Alarm.EXTREMES_DISAGREE} <= set(raised)


def test_the_range_of_traffic_models_counts_as_claimed(right):
    members = TrafficRange((P, P, 0.015, 0.02), (P / 10, P / 10, 0.001, 0.001))
    answer = SimpleNamespace(
        probability=0.015, interval=(0.01, 0.02), traffic_range=members, alarms=()
    )
    assert Alarm.REPLAY_DISAGREES not in right.alarms(answer)


def test_rivals_know_the_margin_when_the_variables_are_independent(right):
    assert [r.name for r in right.rivals] == [
        "independent marginals", "Pareto margins, Gaussian copula",
    ]  # fmt: skip
    free = right.rivals[0]
    assert free.probability == pytest.approx(P, rel=0.7)  # a fit to 20,000 events, far beyond them
    assert free.ladder.p_value > 0.001
    # a is all that the near misses ask for, and both laws know it as well as the model
    assert free.near_misses[0] == pytest.approx(right.tails[0].counts, rel=0.5)


def test_influence_names_the_largest_events(right, known):
    events = known["normal"]().sample(N, 0)
    rows = [e.row - 1 for e in right.influential.events]
    assert len(rows) == 10
    assert {int(np.argmax(np.abs(events[:, 0])))} & set(rows)
    # of log P(a > 4.5) at the fitted mean and deviation: known from the information of a normal
    h = norm.pdf(4.5) / norm.sf(4.5)
    exact = np.sqrt((h**2 + (4.5 * h) ** 2 / 2) / N)
    assert right.influential.relative_error == pytest.approx(exact, rel=0.15)


def test_sentences(right):
    assert len(right.sentences(ANSWER)) == 1  # the choice of 20,000 events decides it well enough


def test_duplicates_are_counted():
    x = np.array([[1.0, 2.0], [1.0, 2.0], [1.0, 2.5], [1.0, 2.0]])
    assert n_duplicates(x) == 2


def test_survives_a_file(right):
    text = json.dumps(right.to_dict(), allow_nan=False)
    assert Check.from_dict(json.loads(text)).to_dict() == right.to_dict()


def test_without_severity_there_is_no_ladder(known):
    model = known["normal"]()
    c = replace(known["comparison"](model, model.sample(2000, 0)), severity=None)
    got = check(c, (), Replay(2000, 10, 0, 0, ()))
    assert got.ladder is None
    assert got.extremes is None
    assert got.influential is not None


def test_without_an_order_extremes_raise_nothing(right):
    answer = SimpleNamespace(
        probability=0.015, interval=(0.01, 0.02), traffic_range=None, alarms=(Alarm.NO_ORDER,)
    )
    assert Alarm.EXTREMES_DISAGREE not in replace(right, ladder=None).alarms(answer)


def test_a_part_that_fails_takes_no_other_with_it(known, monkeypatch):
    from crashrate.recordings import check as module

    def fail(*_):
        raise np.linalg.LinAlgError("singular")

    monkeypatch.setattr(module, "alternatives", fail)
    got = found_anyhow(known)
    assert got.failed == {"other laws of traffic": "singular"}
    assert got.ladder is not None
    assert got.influential is not None
    assert Check.from_dict(json.loads(json.dumps(got.to_dict()))).failed == got.failed


def found_anyhow(known, x=None):
    model = known["normal"]()
    events = model.sample(2000, 0) if x is None else x
    return check(known["comparison"](model, events), QUANTITIES, Replay(len(events), 10, 0, 0, ()))


@pytest.mark.parametrize("kind", ["ties at the top", "integers", "two equal columns", "sixty"])
def test_awkward_events_are_compared(known, kind):
    x = np.array(known["normal"]().sample(2000, 0))
    if kind == "ties at the top":
        x[:, 0] = np.minimum(x[:, 0], 1.5)
    elif kind == "integers":
        x = np.round(x)
    elif kind == "two equal columns":
        x[:, 1] = x[:, 0] = np.abs(x[:, 0])
    else:
        x = x[:60]
    got = found_anyhow(known, x)
    assert got.failed == {}
    assert len(got.rivals) == 2
    # whatever else they are, these are no recordings of that model: but sixty of them are
    # (which say little of its tail)
    unsure = {Alarm.FEW_EVENTS_DECIDE, Alarm.TRAFFIC_UNDETERMINED}
    assert kind != "sixty" or set(got.alarms(ANSWER)) <= unsure
