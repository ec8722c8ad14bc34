"""The deviance's p-value is uniform where the model is right, and small where it is not."""

import numpy as np
import pytest

from crashrate.recordings.ladder import Ladder, deviance, ladder

LEVELS = (1.0, 1.5, 2.0, 2.5)
MASSES = np.array([1e-6, 2e-5, 3e-4, 2e-3])
N = 50_000


def drawn(seed, masses=MASSES):
    rng = np.random.default_rng(seed)
    chances = np.append(masses, 1 - masses.sum())
    return np.repeat(np.arange(len(chances)), rng.multinomial(N, chances))


def found(seed, masses=MASSES, members=None):
    members = np.empty((0, 4)) if members is None else members
    return ladder(LEVELS, drawn(seed, masses), MASSES, members, np.random.default_rng(seed))


def test_right_model_is_hardly_ever_refuted():
    p = np.array([found(seed).p_value for seed in range(200)])
    assert np.count_nonzero(p < 0.01) <= 8  # 2 expected
    assert 0.35 < np.median(p) < 0.7


def test_tail_too_light_by_a_factor_of_two_is_refuted():
    assert all(found(seed, 2 * MASSES).misfit for seed in range(20))


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
