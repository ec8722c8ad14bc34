"""The benchmark problems: their references, margins and transforms."""

import numpy as np
import pytest
from scipy.stats import kstest, norm

WITH_MARGIN = ("A", "B", "C", "D", "disc", "linear, d = 10", "random walk, d = 10")


def problem(name):
    from problems import PROBLEMS

    return PROBLEMS[name]()


def wide_rows(traffic, n=20_000):
    """Situations far enough out for many to crash, inside the box."""
    rng = np.random.default_rng(0)
    x = traffic.mean + 3 * (traffic.sample(n, rng) - traffic.mean)
    return x[traffic.contains(x)]


@pytest.mark.parametrize("name", WITH_MARGIN)
def test_margin_is_below_zero_exactly_in_a_crash(name):
    given = problem(name)
    x = wide_rows(given.traffic)
    crash = given.crash(x)
    assert crash.sum() > 20
    assert np.array_equal(given.margin(x) <= 0, crash)


def test_margin_of_b_is_the_shift_to_the_edge():
    given = problem("B")
    x = wide_rows(given.traffic, 500)
    margin = given.margin(x)[:, None]
    assert given.crash(x + margin + 1e-9).all()
    assert not given.crash(x + margin - 1e-9).any()


def test_walk_of_one_step_and_of_two_against_other_arithmetic():
    from scipy.integrate import quad

    from random_walk import crossing_probability

    assert crossing_probability(4.0, 1) == pytest.approx(norm.sf(4), rel=1e-14)
    second, _ = quad(lambda z: norm.pdf(z) * norm.sf(4 - z), -40, 4, epsabs=0, epsrel=1e-12)
    assert crossing_probability(4.0, 2) == pytest.approx(norm.sf(4) + second, rel=1e-10)


def test_reference_of_the_walk_does_not_depend_on_the_nodes():
    from random_walk import crossing_probability

    assert crossing_probability(15.0, 10, 200) == pytest.approx(
        problem("random walk, d = 10").probability, rel=1e-10
    )


def test_reference_of_the_walk_is_what_simulation_finds():
    from random_walk import crossing_probability

    walks = np.random.default_rng(3).standard_normal((200_000, 10)).cumsum(axis=1)
    n = (walks.max(axis=1) >= 6).sum()
    p = crossing_probability(6.0, 10)
    assert abs(n / 200_000 - p) < 4 * np.sqrt(p / 200_000)
    assert abs(n / 200_000 - crossing_probability(6.3, 10)) > 4 * np.sqrt(p / 200_000)


@pytest.mark.parametrize("name", ["A", "B", "C", "D"])
def test_transform_to_standard_normals_and_back(name):
    from standard_space import StandardSpace

    space = StandardSpace.of(problem(name).traffic)
    d = space.means.shape[1]
    u = np.random.default_rng(1).standard_normal((4000, d))
    u *= np.array([1, 3, 30, 300])[np.arange(4000) % 4][:, None]  # solvers try steps so long
    assert space.to_standard(space.to_situations(u)) == pytest.approx(u, rel=1e-10, abs=1e-12)


@pytest.mark.parametrize("name", ["B", "C"])
def test_transform_carries_the_mixture_to_independent_standard_normals(name):
    from standard_space import StandardSpace

    given = problem(name)
    space, rng = StandardSpace.of(given.traffic), np.random.default_rng(2)
    k = rng.choice(len(space.weights), 4000, p=space.weights)
    z = rng.standard_normal((4000, 3))
    x = space.means[k] + np.einsum("nij,nj->ni", space.factors[k], z)
    u = space.to_standard(x)
    assert min(kstest(column, "norm").pvalue for column in u.T) > 1e-3
    assert np.abs(np.corrcoef(u.T) - np.eye(3)).max() < 4 / np.sqrt(4000)
    # control: the components' weights of the truncated model, or none, are not the mixture
    wrong = StandardSpace(space.weights[::-1], space.means, space.factors, space.p_box)
    assert min(kstest(column, "norm").pvalue for column in wrong.to_standard(x).T) < 1e-6


def test_box_of_c_is_found_by_simulation():
    from standard_space import StandardSpace

    given = problem("C")
    space = StandardSpace.of(given.traffic)
    x = space.to_situations(np.random.default_rng(4).standard_normal((20_000, 3)))
    share = given.traffic.contains(x).mean()
    assert abs(share - space.p_box) < 4 * np.sqrt(0.07 * 0.93 / 20_000)
