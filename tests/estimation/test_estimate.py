"""The answer as a value."""

import json
import math
from dataclasses import replace

import pytest

from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.estimation.estimate import Estimate, HistoryPoint, in_words

ANSWER = Estimate(
    probability=2e-6,
    interval=(1.8e-6, 2.2e-6),
    confidence=0.95,
    standard_error=1e-7,
    bounds=(1e-6, 5e-6),
    n_calls=100,
    n_crashes=40,
    n_failed=0,
    n_eff=400.0,
    largest_weight_share=0.05,
    log_efficiency=1.8,
    alarms=(Alarm.ORDER_CONTRADICTED,),
    stop_reason=StopReason.TARGET_MET,
    method="sequential",
    seed=7,
    history=(HistoryPoint(100, 2e-6, 1.8e-6, 2.2e-6, "estimate"),),
)
NOTHING = replace(ANSWER, probability=math.nan, interval=(0.0, 1.0), standard_error=math.inf)


def test_widths():
    assert ANSWER.half_width == pytest.approx(2e-7)
    assert ANSWER.relative_half_width == pytest.approx(0.1)
    assert NOTHING.relative_half_width == math.inf


def test_crude_monte_carlo_calls():
    n = ANSWER.crude_monte_carlo_calls
    p = ANSWER.probability
    assert 1.959964 * math.sqrt(p * (1 - p) / n) == pytest.approx(ANSWER.half_width, rel=1e-6)
    assert ANSWER.acceleration == pytest.approx(n / 100)
    assert math.isnan(NOTHING.crude_monte_carlo_calls)
    assert math.isnan(replace(ANSWER, n_calls=0).acceleration)


@pytest.mark.parametrize("interval", [(0.0, 4.1e-6), (0.0, 16 * 2e-6), (2e-6, 2e-6)])
def test_nothing_is_compared_with_an_interval_that_is_none(interval):
    wide = replace(ANSWER, interval=interval)
    assert math.isnan(wide.crude_monte_carlo_calls)
    assert math.isnan(wide.acceleration)
    assert "crude" not in wide.sentence()
    assert wide.to_dict()["crude_monte_carlo_calls"] is None
    assert "crude" in replace(ANSWER, interval=(0.1e-6, 3.9e-6)).sentence()


def test_an_estimate_near_one_is_said_by_its_distance_to_one():
    near = replace(ANSWER, probability=1 - 2e-3, interval=(1 - 3e-3, 1.0))
    assert near.sentence() == (
        "P(crash) = 1 - 2.0e-03 per encounter, 95 % Monte Carlo interval [1 - 3.0e-03, 1]; "
        "100 simulator runs"
    )
    even = replace(near, interval=(1 - 3e-3, 1 - 1e-3)).sentence()
    assert even.endswith("100 simulator runs; crude Monte Carlo would need 7,700")


def test_undetermined_is_said_in_the_record_too():
    unseen = replace(NOTHING, probability=0.0, n_crashes=0)
    assert not unseen.to_dict()["determined"]
    assert not NOTHING.to_dict()["determined"]
    assert ANSWER.to_dict()["determined"]


def test_a_wider_confidence_asks_for_more_crude_runs():
    wider = replace(ANSWER, confidence=0.99)
    assert wider.crude_monte_carlo_calls > 1.5 * ANSWER.crude_monte_carlo_calls


def test_sentence():
    assert ANSWER.sentence() == (
        "P(crash) = 2.0e-06 per encounter, 95 % Monte Carlo interval [1.8e-06, 2.2e-06] "
        "(± 10 %); 100 simulator runs; crude Monte Carlo would need 190 million"
    )
    assert NOTHING.sentence() == (
        "P(crash) has no estimate yet; 100 simulator runs, 40 of them crashed"
    )
    bounded = replace(NOTHING, interval=(0.0, 0.12))  # by random encounters
    assert (
        "no estimate yet, 95 % Monte Carlo interval [0.0e+00, 1.2e-01]; 100" in bounded.sentence()
    )
    unseen = replace(NOTHING, probability=0.0, n_crashes=0)
    assert "no crash was seen; 100 simulator runs" in unseen.sentence()
    bounded = replace(unseen, interval=(0.0, 0.02))
    assert "no crash was seen, 95 % Monte Carlo interval [0.0e+00, 2.0e-02]" in bounded.sentence()
    assert "P(fall) = 2.0e-06 per step" in ANSWER.sentence("fall", "step")
    assert "100 simulator runs, 3 of them failed;" in replace(ANSWER, n_failed=3).sentence()
    many = replace(ANSWER, n_calls=12_000, n_failed=1_000).sentence()
    assert "12,000 simulator runs, 1,000 of them failed" in many


def test_a_first_idea_is_no_estimate():
    """Half the interval is more than the estimate: the interval alone is the answer."""
    rough = replace(ANSWER, probability=2e-8, interval=(0.0, 3e-3))
    assert not rough.determined
    assert rough.sentence() == (
        "P(crash) is not determined: 2.0e-08 per encounter so far, 95 % Monte Carlo interval "
        "[0.0e+00, 3.0e-03]; 100 simulator runs, 40 of them crashed"
    )
    assert replace(ANSWER, interval=(0.0, 4e-6)).determined
    assert not replace(ANSWER, probability=0.5, interval=(0.0, 1.0)).determined
    assert replace(ANSWER, probability=0.95, interval=(0.88, 1.0)).determined


def test_an_uneven_interval_is_said_by_its_two_sides():
    """Failed runs count as crashes above and as safe below: there is no one ± of both."""
    uneven = replace(ANSWER, interval=(0.58e-6, 2.16e-6), n_failed=30)
    assert "(-71 %, +8 %); 100 simulator runs, 30 of them failed" in uneven.sentence()
    assert math.isnan(uneven.crude_monte_carlo_calls)


@pytest.mark.parametrize(
    ("phase", "words"),
    [
        ("explore", ": the runs went into finding crashes;"),
        ("learn 3", ": the runs went into learning where they begin;"),
        ("adapt 2", ": the runs went into adapting the proposal;"),
        ("estimate", "no estimate yet;"),
    ],
)
def test_what_the_runs_went_into_is_said_where_there_is_no_estimate(phase, words):
    begun = replace(NOTHING, history=(HistoryPoint(100, math.nan, 0.0, 1.0, phase),))
    assert words in begun.sentence()


def test_sentence_of_bounds():
    bounds = replace(NOTHING, goal="bounds", bounds=(9e-7, 1.08e-6), n_crashes=40)
    assert bounds.sentence() == (
        "bounds if the risk order holds: 9.0e-07 ≤ P(crash) ≤ 1.1e-06 per encounter, a factor "
        "of 1.2; 100 simulator runs"
    )
    one_sided = replace(bounds, bounds=(0.0, 1e-3))
    assert one_sided.bounds_factor == math.inf
    assert "factor" not in one_sided.sentence()
    dropped = replace(bounds, bounds=(0.0, 1.0), alarms=(Alarm.ORDER_DROPPED,))
    assert "no bounds: the risk order was dropped" in dropped.sentence()
    failed = replace(bounds, bounds=(0.0, 1.0), n_failed=100, n_crashes=0)
    assert "no bounds: all 100 simulations failed" in failed.sentence()


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (43210, "43,000"),
        (1.94e8, "190 million"),
        (2.5e9, "2.5 billion"),
        (3e12, "3 trillion"),
        (12, "12"),
        (5e20, "5.0e+20"),
    ],
)
def test_in_words(number, words):
    assert in_words(number) == words


def test_dictionary_is_json_and_holds_everything():
    record = ANSWER.to_dict()
    assert json.loads(json.dumps(record, allow_nan=False)) == record
    assert record["schema"] == "crashrate.result/1"
    assert record["alarms"] == [
        {"name": "ORDER_CONTRADICTED", "message": Alarm.ORDER_CONTRADICTED.value}
    ]
    assert record["stop_reason"] == "the target was met"
    assert record["history"][0]["n_calls"] == 100
    fields = set(Estimate.__dataclass_fields__)
    assert fields | {"relative_half_width", "crude_monte_carlo_calls", "acceleration"} <= set(
        record
    )


def test_dictionary_of_no_answer_has_none_for_what_is_not_finite():
    record = NOTHING.to_dict()
    json.dumps(record, allow_nan=False)
    assert record["probability"] is None
    assert record["standard_error"] is None
    assert record["relative_half_width"] is None
