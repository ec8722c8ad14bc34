import numpy as np
import pytest
from scipy.stats import binomtest

from crashrate.recordings.replay import LEAST, Replay, replayed, to_simulate


def test_events_in_doubt_come_first_and_an_audit_in_any_case():
    h = np.zeros(100)
    h[[7, 3, 50]] = 0.9, 0.2, 0.01
    own = np.linspace(0, 1e-4, 100)
    chosen = to_simulate(h, own, 1000, ordered=True)
    assert chosen[:5].tolist() == [7, 3, 50, 99, 98]  # then by the surrogate's own opinion
    assert len(chosen) == LEAST
    assert to_simulate(h, own, 2, ordered=True).tolist() == [7, 3]
    assert len(to_simulate(h, own, 0, ordered=True)) == 0
    assert len(to_simulate(np.full(100, 0.5), own, 1000, ordered=True)) == 100


def test_without_an_order_all_of_the_budget_is_used():
    own = np.linspace(0, 1e-4, 100)
    assert len(to_simulate(np.zeros(100), own, 37, ordered=False)) == 37
    text = Replay(100, 37, 1, 0, (4,), ordered=False).sentence()
    assert text.endswith("37 simulated; the others by the surrogate alone)")


def test_failed_simulations_are_named():
    text = Replay(100, 11, 0, 3, (), n_failed=2).sentence()
    assert "3 in doubt (2 failed)" in text


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
