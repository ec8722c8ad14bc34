"""The deviance's p-value is uniform where the model is right, and small where it is not."""

from types import SimpleNamespace

import numpy as np
import pytest

from crashrate.recordings.expectation import Draws
from crashrate.recordings.ladder import Ladder, deviance, ladder

LEVELS = (1.0, 1.5, 2.0, 2.5)
MASSES = np.array([1e-6, 2e-5, 3e-4, 2e-3])
N = 50_000


def drawn(seed, masses=MASSES, n=N):
    rng = np.random.default_rng(seed)
    chances = np.append(masses, 1 - masses.sum())
    return np.repeat(np.arange(len(chances)), rng.multinomial(n, chances))


def expected(seed=0, masses=MASSES, error=1e-4):
    """Draws whose sums are the masses, to a relative error of which they know."""
    per_set = round(error**-2) if error > 1e-3 else 1
    scale = 1 + error * np.random.default_rng(seed + 1000).standard_normal(len(masses))
    index = np.repeat(np.arange(len(masses)), per_set)
    weights = (masses * scale / per_set)[index]
    return Draws(np.empty((len(index), 1)), weights, index, len(masses))


def exactly(masses=MASSES):
    draws = expected(masses=masses, error=0.0 + 1e-9)
    return SimpleNamespace(probabilities=draws.probabilities, standard_errors=0 * masses)


def found(seed, masses=MASSES, members=None):
    rng = np.random.default_rng(seed)
    return ladder(LEVELS, drawn(seed, masses), exactly(), rng, members)


def test_right_model_is_hardly_ever_refuted():
    p = np.array([found(seed).p_value for seed in range(200)])
    assert np.count_nonzero(p < 0.01) <= 8  # 2 expected
    assert 0.35 < np.median(p) < 0.7


def test_tail_too_light_by_a_factor_of_two_is_refuted():
    assert all(found(seed, 2 * MASSES).misfit for seed in range(20))


def test_errors_of_the_expectation_refute_no_model():
    """A million events, an integral known to 1 %: the p-value knows of it."""
    masses = np.array([1e-5, 1e-4, 1e-2, 7e-2])
    p, naive = [], []
    for seed in range(60):
        first, draws = drawn(seed, masses, 1_000_000), expected(seed, masses, 0.01)
        rng = np.random.default_rng(seed)
        p.append(ladder(LEVELS, first, draws, rng).p_value)
        sure = SimpleNamespace(probabilities=draws.probabilities, standard_errors=0 * masses)
        naive.append(ladder(LEVELS, first, sure, rng).p_value)
    assert np.count_nonzero(np.array(p) < 0.01) <= 4
    assert np.count_nonzero(np.array(naive) < 0.01) > 12  # the test can fail


def test_a_set_that_no_draw_met_says_nothing():
    masses = np.array([0.0, 2e-5, 3e-4, 2e-3])
    got = ladder(LEVELS, drawn(1), exactly(masses), np.random.default_rng(0))
    assert np.isfinite(got.deviance)
    assert got.p_value > 0.01


def test_counts_are_those_of_the_levels_and_all_below():
    got = found(3)
    first = drawn(3)
    assert got.observed == tuple(int((first <= j).sum()) for j in range(4))
    assert got.expected == pytest.approx(N * np.cumsum(MASSES))
    assert got.low == got.high == ()


def test_members_give_a_range():
    got = found(3, members=np.stack([0.5 * MASSES, MASSES, 2 * MASSES]))
    assert np.all(np.array(got.low) < got.expected)
    assert np.all(np.array(got.expected) < got.high)


def test_deviance_of_counts_as_expected_is_zero_and_of_the_impossible_infinite():
    assert deviance(np.array([3.0, 0.0]), np.array([3.0, 0.0])) == 0.0
    assert deviance(np.array([1.0]), np.array([0.0])) == np.inf


def test_survives_a_file():
    assert Ladder.from_dict(found(1).to_dict()).to_dict() == found(1).to_dict()


def test_a_ladder_on_which_nothing_happens_is_no_test():
    nothing = Ladder(LEVELS, (0, 0, 0, 0), (0.0, 0.0, 0.1, 0.2), (), (), 0.4, 1.0)
    assert not nothing.tested
    assert found(0).tested
    assert Ladder(LEVELS, (0, 0, 0, 0), (0.0, 0.0, 2.0, 9.0), (), (), 18.0, 1e-4).tested
