"""All parts together, on events drawn from a known law: quiet where the model is right."""

import json
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
ANSWER = SimpleNamespace(interval=(0.9 * P, 1.1 * P), traffic_range=None)


def found(known, model, seed=0, replay=None):
    events = known["normal"]().sample(N, seed)
    said = []
    got = check(
        known["comparison"](model, events, seed), QUANTITIES, replay or Replay(N, 10, 0, 0, ()),
        said.append,
    )  # fmt: skip
    assert len(said) == 4
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


def test_an_answer_that_events_exclude_is_seen(right):
    answer = SimpleNamespace(interval=(0.01, 0.02), traffic_range=None)
    raised = right.alarms(answer)
    assert {Alarm.REPLAY_DISAGREES, Alarm.EXTREMES_DISAGREE} <= set(raised)


def test_the_range_of_traffic_models_counts_as_claimed(right):
    members = TrafficRange((P, P, 0.015, 0.02), (P / 10, P / 10, 0.001, 0.001))
    answer = SimpleNamespace(interval=(0.01, 0.02), traffic_range=members)
    assert Alarm.REPLAY_DISAGREES not in right.alarms(answer)


def test_rivals_know_the_margin_when_the_variables_are_independent(right):
    assert [r.name for r in right.rivals] == [
        "independent marginals", "Pareto margins, Gaussian copula",
    ]  # fmt: skip
    free = right.rivals[0]
    assert free.probability == pytest.approx(P, rel=0.7)  # a fit to 20,000 events, far beyond them
    assert free.ladder.p_value > 0.001


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
    from dataclasses import replace

    model = known["normal"]()
    c = replace(known["comparison"](model, model.sample(2000, 0)), severity=None)
    got = check(c, (), Replay(2000, 10, 0, 0, ()))
    assert got.ladder is None
    assert got.extremes is None
    assert got.influential is not None
