import csv
import math
import pickle
from pathlib import Path

import numpy as np
import pytest

from crashrate.errors import InvalidInputError
from crashrate.simulators import AccAeb

SHARED = Path(__file__).resolve().parents[2] / ".." / "shared" / "data"
LABELS = SHARED / "plant_labels_1000.csv"
EVENTS = SHARED / "spmd_lane_changes.parquet"


def one_run(v_lead, gap, closing):
    """The plant written again as one loop over plain numbers: (crash, smallest range)."""
    ego, remembered, last_error, output = v_lead + closing, 0.0, 0.0, 0.0
    braking, brake_time, at_trigger, smallest = False, 0.0, 0.0, gap
    if ego <= 0.0:
        return False, smallest
    for _ in range(81):
        speed = ego - v_lead
        ttc = gap / speed if speed else math.inf
        threshold = 0.835 + 0.0075 * (ego - 1.111) if ego < 40 / 3.6 else 0.91
        if braking and (ttc > 1.0 or ttc < 0.0):
            braking, last_error = False, 0.0
        elif not braking and 0.0 < ttc <= threshold:
            braking, brake_time, at_trigger = True, 0.0, remembered
        error = 2.0 - gap / ego
        command = (
            remembered
            - 38.6252446973784 * (error - last_error)
            - 1.35416845633818 * 0.05 * (error + last_error)
        )
        command = min(5.0, max(-5.0, command))
        if ego >= 90 / 2.236:
            command = min(command, 0.0)
        if braking:
            brake_time += 0.1
            command = max(-10.0, at_trigger - 16.0 * brake_time)
        wanted = min(9.8, max(-9.8, command))
        output = min(output + 2.0, max(output - 2.0, wanted))
        remembered, last_error = command, error
        # in the plant's order of operations: near standstill R / v is so large that the rounding
        # of another order switches the controller
        gap = gap + (v_lead - ego) * 0.1 - output * (0.1**2 / 2.0)
        ego += output * 0.1
        smallest = min(smallest, gap)
        if gap <= 0.0 or ego <= 0.0:
            break
    return gap < 0.0, max(smallest, 0.0)


def random_events(n, seed):
    rng = np.random.default_rng(seed)
    v_lead = rng.uniform(0.0, 40.0, n)
    gap = np.exp(rng.uniform(np.log(0.5), np.log(100.0), n))
    return v_lead, gap, rng.uniform(np.maximum(-5.0, -v_lead), 30.0)


def run(plant, v_lead, gap, closing):
    return plant.run(v_lead=v_lead, range=gap, closing_speed=closing)


@pytest.mark.skipif(not LABELS.exists(), reason="needs ../shared/data/plant_labels_1000.csv")
def test_every_recorded_outcome_is_reproduced():
    with LABELS.open() as file:
        rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    v, inv_ttc, inv_range, crash = (
        np.array([row[k] for row in rows]) for k in ("v_lead", "inv_ttc", "inv_range", "crash")
    )
    assert len(rows) == 1000
    result = run(AccAeb.published(), v, 1.0 / inv_range, inv_ttc / inv_range)
    np.testing.assert_array_equal(result.crash, crash == 1.0)


@pytest.mark.skipif(not EVENTS.exists(), reason="needs ../shared/data/spmd_lane_changes.parquet")
def test_real_events_replayed():
    import pyarrow.parquet as pq

    table = pq.read_table(EVENTS)
    v, inv_range, inv_ttc = (
        table[k].to_numpy().astype(float) for k in ("v_lead", "inv_range", "inv_ttc")
    )
    result = run(AccAeb.published(), v, 1.0 / inv_range, inv_ttc / inv_range)
    assert result.crash.sum() == 1
    assert (result.min_range < 5.0).sum() == 119
    assert 0.015 < result.input_altered.mean() < 0.025


def test_vectorised_plant_equals_one_loop_over_plain_numbers():
    events = random_events(3000, seed=1)
    result = run(AccAeb(), *events)
    expected = [one_run(*map(float, event)) for event in zip(*events, strict=True)]
    crash, smallest = (np.array(column) for column in zip(*expected, strict=True))
    np.testing.assert_array_equal(result.crash, crash)
    np.testing.assert_allclose(result.min_range, smallest, rtol=1e-9)
    assert 0.2 < crash.mean() < 0.8


def test_outcomes_do_not_depend_on_the_block_a_run_is_in():
    v, gap, closing = random_events(20_000, seed=2)
    whole = run(AccAeb(), v, gap, closing)
    tail = run(AccAeb(), v[8000:8400], gap[8000:8400], closing[8000:8400])
    np.testing.assert_array_equal(whole.min_range[8000:8400], tail.min_range)
    np.testing.assert_array_equal(whole.impact_speed[8000:8400], tail.impact_speed)


def test_result_of_a_hopeless_event_by_hand():
    # R = 1 m, closing at 20 m/s: the range is gone within the first 0.1 s, with a_0 = -2 m/s²
    result = run(AccAeb(), 10.0, 1.0, 20.0)
    assert result.crash
    assert result.min_range == 0.0
    assert result.impact_speed == pytest.approx(math.sqrt(20.0**2 - 2.0 * 1.6 * 1.0))
    assert not result.input_altered


def test_impact_speed_is_nan_exactly_where_there_is_no_crash():
    v, gap, closing = random_events(2000, seed=3)
    result = run(AccAeb(), v, gap, closing)
    np.testing.assert_array_equal(np.isnan(result.impact_speed), ~result.crash)
    speed = result.impact_speed[result.crash]
    assert (speed >= 0.0).all()
    np.testing.assert_array_equal(result.min_range[result.crash], 0.0)
    assert (result.min_range <= gap).all()


def test_arguments_are_broadcast_and_the_shape_is_kept():
    result = run(AccAeb(), 10.0, np.array([[1.0], [50.0]]), np.array([0.0, 10.0, 20.0]))
    assert result.crash.shape == (2, 3)
    assert run(AccAeb(), 10.0, 30.0, 1.0).min_range.shape == ()
    assert run(AccAeb(), [], [], []).crash.shape == (0,)
    assert not result.crash.flags.writeable


def test_published_caps_change_the_event_and_say_so():
    plant = AccAeb.published()
    v, gap, closing = np.array([5.0, 5.0, 30.0]), 40.0, np.array([23.0, 26.0, 8.0])
    result = run(plant, v, gap, closing)
    np.testing.assert_array_equal(result.input_altered, [False, True, True])
    capped = run(AccAeb(), v, gap, [23.0, 23.49, 5.0])
    np.testing.assert_array_equal(result.min_range, capped.min_range)
    np.testing.assert_array_equal(plant.altered(v_lead=v, closing_speed=closing), [0, 1, 1])
    assert not run(AccAeb(), v, gap, closing).input_altered.any()
    assert not np.array_equal(run(AccAeb(), v, gap, closing).min_range, result.min_range)


def test_standing_follower_never_crashes():
    result = run(AccAeb(), [0.0, 3.0], 0.5, [0.0, -3.0])
    assert not result.crash.any()
    np.testing.assert_array_equal(result.min_range, 0.5)


def test_danger_grows_with_lead_speed_down_closing_speed_up_range_down():
    rng = np.random.default_rng(4)
    n = 40_000
    v = rng.uniform(5.0, 35.0, (2, n))
    gap = np.exp(rng.uniform(np.log(1.0), np.log(75.0), (2, n)))
    closing = rng.uniform(0.5, 23.0, (2, n))
    worse = run(AccAeb(), v.min(axis=0), gap.min(axis=0), closing.max(axis=0)).crash
    better = run(AccAeb(), v.max(axis=0), gap.max(axis=0), closing.min(axis=0)).crash
    assert better.any()
    assert (better & ~worse).mean() < 1e-4
    # negative control: the published order (v, TTC, R) is violated by this plant
    ttc = rng.uniform(0.3, 3.0, n)
    far, near = gap.max(axis=0), gap.min(axis=0)
    far_crash = run(AccAeb(), v[0], far, far / ttc).crash
    near_crash = run(AccAeb(), v[0], near, near / ttc).crash
    assert (far_crash & ~near_crash).mean() > 1e-2


@pytest.mark.parametrize(
    ("event", "message"),
    [
        ((np.nan, 10.0, 1.0), "v_lead: expected a finite speed >= 0 m/s, got nan at event 0"),
        ((-1.0, 10.0, 2.0), "v_lead"),
        ((10.0, 0.0, 1.0), "range: expected a finite range > 0 m, got 0.0"),
        ((10.0, np.inf, 1.0), "range"),
        ((10.0, [5.0, 6.0, -7.0, -8.0], 1.0), r"got -7.0 at event 2 \(2 such events of 4\)"),
        ((10.0, 5.0, np.inf), "closing_speed"),
        ((10.0, 5.0, -11.0), "closing speed >= -v_lead"),
        (([1.0, 2.0], [1.0, 2.0, 3.0], 0.0), r"v_lead \(2,\), range \(3,\)"),
    ],
)
def test_events_that_cannot_be_are_refused(event, message):
    with pytest.raises(InvalidInputError, match=message):
        run(AccAeb(), *event)


def test_plant_is_a_value():
    assert AccAeb.published() == AccAeb(23.49, 35.0)
    assert pickle.loads(pickle.dumps(AccAeb.published())) == AccAeb.published()  # noqa: S301
    with pytest.raises(InvalidInputError, match="closing_speed_cap"):
        AccAeb(closing_speed_cap=-1.0)
    with pytest.raises(InvalidInputError, match="ego_speed_cap"):
        AccAeb(ego_speed_cap=math.nan)
