"""Places far from all runs, in the units of the component of traffic that each belongs to."""

import numpy as np
import pytest
from scipy.stats import norm

from crashrate.estimation import exploration, surveying
from crashrate.estimation.alarms import Alarm
from crashrate.estimation.local_units import farthest_locally
from crashrate.estimation.probing import farthest
from crashrate.estimation.run import estimate
from crashrate.traffic.model import TrafficModel

SHARE, WIDTH, AT, EDGE = 0.3, 0.2, np.array([6.0, -6.0]), 4.0
TRUTH = (1 - SHARE) * (norm.sf(4.75) + norm.sf(6 + WIDTH * EDGE)) + SHARE * norm.sf(EDGE)


@pytest.fixture(scope="module")
def traffic():
    """A broad component and a tight one beside it."""
    return TrafficModel(
        [1 - SHARE, SHARE],
        [[0.0, 0.0], AT],
        [np.eye(2), WIDTH**2 * np.eye(2)],
        [-np.inf] * 2,
        [np.inf] * 2,
        ("a", "b"),
    )


def crash(x):
    """Two half-planes, one beyond either component."""
    return (x.sum(axis=1) / np.sqrt(2) >= 4.75) | (x[:, 1] < AT[1] - WIDTH * EDGE)


def test_tight_components_have_as_many_places_as_broad_ones(traffic):
    rng = np.random.default_rng(0)
    disc = rng.uniform(-4, 4, (4000, 2))
    disc = disc[(disc**2).sum(axis=1) < 16]
    x = np.concatenate([disc, AT + WIDTH * disc])
    tight = np.arange(len(x)) >= len(disc)
    runs = np.array([[0.0, 0.0], AT])
    level = np.zeros(len(x))  # all equally dense: distances alone
    found = farthest_locally(traffic, x, runs, level, 20)
    assert len(np.unique(found)) == 20
    assert 8 <= np.count_nonzero(tight[found]) <= 12
    in_one_unit = farthest(x, runs, np.arange(len(x)), 20)
    assert np.count_nonzero(tight[in_one_unit]) <= 2


def test_the_denser_of_two_regions_has_more_places_but_not_the_rim(traffic):
    rng = np.random.default_rng(1)
    x = rng.uniform(-4, 4, (4000, 2))
    log_f = -0.5 * (x**2).sum(axis=1)
    runs = np.array([[9.0, 9.0]])
    by_density = farthest_locally(traffic, x, runs, log_f, 30)
    even = farthest_locally(traffic, x, runs, 0 * log_f, 30)
    assert log_f[by_density].mean() > log_f[even].mean()
    np.testing.assert_array_equal(by_density[:10], even[:10])  # a third is not weighed


def test_known_places_and_none_at_all(traffic):
    x = np.zeros((3, 2))
    assert len(farthest_locally(traffic, x, x[:1], np.zeros(3), 2)) == 0
    assert len(farthest_locally(traffic, x[:0], x, np.zeros(0), 2)) == 0


def test_a_space_that_is_filled_needs_no_more(traffic):
    line = np.linspace(-3.0, 3.0, 7)
    grid = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    x = np.random.default_rng(2).uniform(-3, 3, (500, 2))
    log_f = np.zeros(len(x))
    assert len(farthest_locally(traffic, x, grid, log_f, 5, least=0.8)) == 0
    assert len(farthest_locally(traffic, x, grid[:-6], log_f, 5, least=0.8)) == 5


def test_a_half_plane_beside_a_tight_component_is_not_missed(traffic, monkeypatch):
    """It holds nine tenths of the probability."""
    options = {"relative_half_width": 0.25, "max_calls": 500, "seed": 1}
    study = estimate(crash, traffic, **options)
    assert study.interval[0] <= TRUTH <= study.interval[1]
    monkeypatch.setattr(surveying, "N_DENSER_FIRST", 0)
    monkeypatch.setattr(surveying, "N_DENSER", 0)
    monkeypatch.setattr(exploration, "MESH", 0)
    lost = estimate(crash, traffic, **options)
    assert lost.interval[1] < 0.1 * TRUTH
    assert lost.alarms == (Alarm.NO_ORDER,)
