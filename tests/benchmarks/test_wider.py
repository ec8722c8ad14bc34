"""The wider problems: each reference against another way to compute it, each control refuted."""

import numpy as np
import pytest
from scipy.stats import kstest, norm

N = 1_000_000
# deviations by which traffic is widened to meet enough crashes
WIDENED = {
    "outside a ball, d = 2": 3.0,
    "outside a ball, d = 3": 2.5,
    "corner, d = 3": 2.5,
    "corner, d = 4": 1.0,
    "union, d = 3": 2.5,
    "union, d = 5": 2.0,
    "three half-planes": 3.0,
    "stairs": 2.5,
    "pocket": 3.0,
    "strip": 3.0,
    "ring": 3.0,
    "stripes": 3.0,
    "rare ring": 6.0,
    "dense disc": 1.5,
    "dense disc, small": 1.5,
    "dense ball, d = 3": 1.5,
    "holes in 0.1 %": 3.0,
    "holes in 1 %": 3.0,
    "holes in 10 %": 3.0,
    "random outcome": 3.0,
    "mostly outside the box": 2.5,
    "half of the time, d = 2": 1.0,
    "half of the time, d = 4": 1.0,
    "wrong sign": 3.0,
    "left out, alone": 3.0,
    "left out, together": 2.5,
    "hidden direction": 3.0,
    "hidden direction, d = 4": 2.5,
    "left out, nothing": 2.5,
}
# … and moved along every coordinate, where widened traffic hardly gets
MOVED = {"corner, d = 4": 2.5, "rare ring": -6.0}


def problem(name):
    from problems import PROBLEMS

    return PROBLEMS[name]()


def simulated(given, factor, shift):
    """The probability by importance sampling from widened, moved traffic; its standard error."""
    from crashrate.sampling.gaussians import Gaussians

    traffic, rng = given.traffic, np.random.default_rng(7)
    covariance = factor**2 * traffic.covariance[None]
    proposal = Gaussians(np.ones(1), traffic.mean[None] + shift, covariance)
    x = proposal.sample(N, rng)
    x = x[traffic.contains(x)]
    x = x[given.crash(x)]
    weights = np.exp(traffic.log_density(x) - proposal.log_density(x))
    estimate = weights.sum() / N
    return estimate, np.sqrt((weights @ weights) / N - estimate**2) / np.sqrt(N)


@pytest.mark.parametrize("name", WIDENED)
def test_reference_is_what_simulation_finds(name):
    given = problem(name)
    estimate, error = simulated(given, WIDENED[name], MOVED.get(name, 0.0))
    assert abs(estimate - given.probability) < 4 * error
    assert abs(estimate - 1.1 * given.probability) > 4 * error


def test_every_wider_problem_is_checked():
    from unseen import UNSEEN
    from wider import WIDER

    assert set(UNSEEN) <= set(WIDENED)
    assert set(WIDER) - set(WIDENED) == {"never", "never, no order"}


@pytest.mark.parametrize("name", ["never", "never, no order"])
def test_never(name):
    given = problem(name)
    x = 9 * np.random.default_rng(0).standard_normal((1000, 2))
    assert given.probability == 0
    assert not given.crash(x).any()


@pytest.mark.parametrize("d", [1, 2, 4, 10])
@pytest.mark.parametrize("power", range(2, 10))
def test_half_spaces_are_as_probable_as_their_names_say(d, power):
    given = problem(f"linear, d = {d}, 1e-{power}")
    free = problem(f"linear, d = {d}, 1e-{power}, no order")
    assert free.risk is None
    assert set(given.risk.values()) == {"increasing"}
    z, rng = norm.isf(10.0**-power), np.random.default_rng([d, power])
    point = np.full(d, z / np.sqrt(d))  # the likeliest crash
    x = point + rng.standard_normal((40_000, d))
    crash = given.crash(x)
    assert np.array_equal(free.crash(x), crash)
    weights = np.exp(z * z / 2 - x @ point) * crash
    error = weights.std() / np.sqrt(len(x))
    assert abs(weights.mean() - 10.0**-power) < 4 * error
    assert abs(weights.mean() - 1.1 * 10.0**-power) > 4 * error


def test_holes_everywhere_leave_nothing_and_nowhere_everything():
    from cells import probability_with_holes

    level = np.sqrt(2) * norm.isf(1e-5)
    assert probability_with_holes(level, 0.0) == pytest.approx(1e-5, rel=1e-14)
    assert probability_with_holes(level, 1.0) == pytest.approx(0, abs=1e-17)


@pytest.mark.parametrize("share", [0.001, 0.01, 0.1])
def test_holes_lose_what_simulation_loses(share):
    from cells import in_hole, probability_with_holes

    a, rng = norm.isf(1e-5), np.random.default_rng(5)
    across, along = a + rng.exponential(1 / a, N), rng.standard_normal(N)
    x = np.column_stack([across + along, across - along]) / np.sqrt(2)
    weights = norm.pdf(across) / (a * np.exp(-a * (across - a)))
    lost = weights * in_hole(x, share)
    error = lost.std() / np.sqrt(N)
    expected = 1e-5 - probability_with_holes(np.sqrt(2) * a, share)
    assert abs(lost.mean() - expected) < 4 * error
    assert abs(lost.mean() - 1.5 * expected) > 4 * error


def test_sum_of_truncated_normals_does_not_depend_on_the_nodes():
    from truncated_sum import sum_probability

    for means, s in (((1.0, 1.0), 1.0), ((-4.0, 3.0), np.sqrt(1.5))):
        assert sum_probability(7.2, means, (s, s), 100) == pytest.approx(
            sum_probability(7.2, means, (s, s)), rel=1e-12
        )


def test_hash_looks_random():
    from cells import uniform

    i, j = (k.ravel() for k in np.meshgrid(np.arange(-300, 300), np.arange(-300, 300)))
    u = uniform(np.column_stack([i, j]))
    assert kstest(u, "uniform").pvalue > 1e-3
    field = u.reshape(600, 600)
    for shifted in (np.roll(field, 1, 0), np.roll(field, 1, 1), field.T, uniform_again(i, j)):
        assert abs(np.corrcoef(field.ravel(), shifted.ravel())[0, 1]) < 4 / 600
    # control: the words themselves are no noise
    assert kstest((i % 100) / 1000, "uniform").pvalue < 1e-6


def uniform_again(i, j):
    from cells import uniform

    return uniform(np.column_stack([i, j]), seed=1)


def test_random_outcomes_are_of_the_situation_not_of_the_batch():
    given = problem("random outcome")
    x = np.random.default_rng(2).normal(2.6, 0.3, (400, 2))
    crash = given.crash(x)
    assert 50 < crash.sum() < 350
    assert np.array_equal(given.crash(x[::-1])[::-1], crash)
    assert [bool(given.crash(row[None])[0]) for row in x] == crash.tolist()
    # neighbours differ: no edge could be learned
    assert (given.crash(x + 1e-12) != crash).sum() > 20
