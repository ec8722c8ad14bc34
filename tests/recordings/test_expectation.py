"""Probabilities of rare sets under a law: unbiased, with honest errors, over many seeds."""

import numpy as np
import pytest
from scipy.stats import norm

from crashrate.recordings.expectation import Search, rare_draws
from crashrate.sampling.gaussians import Gaussians

EDGES = np.array([4.5, 3.5, 2.5, 1.8])  # the sets: a > 4.5, then what is added by each edge
ABOVE = norm.sf(EDGES)
EXACT = np.diff(np.concatenate([[0.0], ABOVE]))


def index(x):
    return np.searchsorted(-EDGES, -x[:, 0], side="left")


def draws(known, seed, mean=0.0, sets=index):
    wide = Gaussians(np.ones(1), np.zeros((1, 2)), 4 * np.eye(2)[None])
    narrow = Gaussians(np.ones(1), np.array([[0.0, 3.0]]), 0.1 * np.eye(2)[None])  # far off
    search = Search(sets, len(EDGES), narrow, wide)
    return rare_draws(known["normal"](mean), search, np.random.default_rng(seed))


@pytest.fixture(scope="module")
def studies(known):
    return [draws(known, seed) for seed in range(12)]


def test_probabilities_are_unbiased_and_errors_honest(studies):
    z = np.array([(d.probabilities - EXACT) / d.standard_errors for d in studies])
    assert np.abs(z.mean(axis=0)).max() < 4 / np.sqrt(len(studies))
    assert np.abs(z).max() < 4.5
    wrong = np.array([(d.probabilities - EXACT[::-1]) / d.standard_errors for d in studies])
    assert np.abs(wrong.mean(axis=0)).max() > 10  # the check can fail


def test_every_set_is_known_well_however_rare(studies):
    relative = np.array([d.standard_errors / d.probabilities for d in studies])
    assert relative.max() < 0.05


def test_other_laws_from_the_same_draws(known, studies):
    base, other = known["normal"](0.0), known["normal"](0.3)
    exact = np.diff(np.concatenate([[0.0], norm.sf(EDGES - 0.3)]))
    found = [
        d.under(np.exp(other.log_density(d.x) - base.log_density(d.x))[:, None])[0] for d in studies
    ]
    assert np.mean(found, axis=0) == pytest.approx(exact, rel=0.03)


def test_sets_that_are_never_met_have_probability_zero(known):
    found = draws(known, 0, sets=lambda x: np.full(len(x), len(EDGES)))
    assert found.probabilities.tolist() == [0.0] * len(EDGES)
    assert len(found.x) == 0
