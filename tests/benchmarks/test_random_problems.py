"""Problems drawn at random: their references, and that danger grows as it is declared to."""

import numpy as np
import pytest
from scipy.stats import norm


@pytest.mark.parametrize("p", [1e-3, 1e-7])
def test_reference_of_a_half_space_is_exact(p):
    from benchmark import standard_normal
    from random_problems import PRECISE, reference

    level, found = reference(
        standard_normal(3), lambda x: x.sum(axis=1) / np.sqrt(3), p, np.random.default_rng(1)
    )
    exact = norm.sf(level)
    assert found == pytest.approx(exact, rel=4 * PRECISE)
    assert exact == pytest.approx(p, rel=0.1)


@pytest.mark.parametrize("seed", range(7))
def test_problems_keep_their_order(seed):
    from random_problems import SHAPES, problem

    shape, given = problem(seed)
    assert shape == list(SHAPES)[seed]
    rng = np.random.default_rng(seed)
    x = given.traffic.mean + 6 * (given.traffic.sample(4000, rng) - given.traffic.mean)
    sign = np.array([1.0 if way == "increasing" else -1.0 for way in given.risk.values()])
    worse = x + sign * rng.exponential(1.0, x.shape)
    crash = given.crash(x)
    assert 10 < crash.sum() < 3990
    assert given.crash(worse)[crash].all()


def test_reference_counts_what_ordinary_traffic_meets():
    from random_problems import problem

    _, given = problem(11)
    assert problem(11)[1].probability == given.probability
    # p = 6.5e-3: a hundred thousand encounters tell it to 4 %
    x = given.traffic.sample(100_000, np.random.default_rng(0))
    crashes = int(given.crash(x).sum())
    assert abs(crashes - 1e5 * given.probability) < 4 * np.sqrt(1e5 * given.probability)


def test_table_counts_silent_misses():
    from random_problems import table

    common = {"shape": "plane", "d": 2, "reference": 1e-6, "calls": 90, "stop": "TARGET_MET"}
    records = [
        common | {"probability": 1.02e-6, "covered": True, "alarms": ["NO_ORDER"]},
        common | {"probability": 0.98e-6, "covered": True, "alarms": []},
        common | {"probability": 0.5e-6, "covered": False, "alarms": []},
        common | {"probability": 0.5e-6, "covered": False, "alarms": ["ORDER_DROPPED"]},
    ]
    assert "| all | 4 | 90 | 2 (7–93 %) | 2 of 3 | -25.0 ± 14.5 % |" in table(records)
