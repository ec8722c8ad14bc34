import numpy as np
import pytest
from scipy.stats import binomtest

from crashrate.recordings.replay import LEAST, Replay, replayed, to_simulate


def test_events_in_doubt_come_first_and_an_audit_in_any_case():
    h = np.zeros(100)
    h[[7, 3, 50]] = 0.9, 0.2, 0.01
    chosen = to_simulate(h, 1000)
    assert chosen[:3].tolist() == [7, 3, 50]
    assert len(chosen) == LEAST
    assert to_simulate(h, 2).tolist() == [7, 3]
    assert len(to_simulate(h, 0)) == 0
    assert len(to_simulate(np.full(100, 0.5), 1000)) == 100


@pytest.mark.parametrize(("n", "k"), [(157_757, 1), (157_757, 0), (1000, 40), (5, 5)])
def test_interval_is_clopper_pearson(n, k):
    ci = binomtest(k, n).proportion_ci(0.95)
    assert Replay(n, 10, k, 0, ()).interval == pytest.approx((ci.low, ci.high))


def test_figures_of_the_recorded_lane_changes():
    replay = Replay(157_757, 12, 1, 0, (136_426,))
    assert replay.sentence() == (
        "replay: the 157,757 events themselves give 6.3e-06 [1.6e-07, 3.5e-05] "
        "(1 crash; 12 simulated)"
    )


def test_events_left_in_doubt_count_in_the_upper_end_alone():
    h = np.array([0.9, 0.8, 0.7, 1e-9, 0.0])
    outcomes = np.array([1.0, np.nan, np.nan, np.nan, np.nan])  # failed, not simulated, settled
    failed = np.array([False, True, False, False, False])
    rows = np.array([10, 11, 12, 13, 14])
    got = replayed(h, outcomes, rows, failed=failed, n_runs=2, confidence=0.95)
    assert (got.n_simulated, got.n_crashes, got.n_open) == (2, 1, 2)
    assert got.crashing == (11,)  # counted from 1
    assert got.probability == pytest.approx((1 + 0.8 + 0.7) / 5)
    low, high = got.interval
    assert low == pytest.approx(binomtest(1, 5).proportion_ci(0.95).low)
    assert high == pytest.approx(binomtest(3, 5).proportion_ci(0.95).high)
    assert "give about 5.0e-01" in got.sentence()
    assert "2 in doubt" in got.sentence()


def test_survives_a_file():
    replay = Replay(100, 10, 1, 2, (4, 7), 0.5, 0.9)
    assert Replay.from_dict(replay.to_dict()) == replay
