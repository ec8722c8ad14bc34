import numpy as np
import pytest
from scipy.stats import kstest

from crashrate.crash_set.monotone_set import MonotoneSet
from crashrate.crash_set.order import RiskOrder
from crashrate.errors import InvalidInputError
from crashrate.sampling.orthants import dominating_points
from crashrate.sampling.proposals import (
    Proposal,
    blend,
    learning_rho,
    mixed,
    recommended_rho,
    separation,
    shifted,
)
from crashrate.traffic.model import TrafficModel

NAMES = ("a", "b")


@pytest.fixture(scope="module")
def traffic():
    return TrafficModel(
        weights=[0.6, 0.4],
        means=[[0.0, 0.0], [-2.0, 1.0]],
        covariances=[[[1.0, 0.5], [0.5, 2.0]], [[4.0, 0.0], [0.0, 0.25]]],
        lower=[-1.0, -np.inf],
        upper=[np.inf, 4.0],
        names=NAMES,
    )


@pytest.fixture(scope="module")
def order():
    return RiskOrder.from_mapping({"a": "increasing", "b": "increasing"}, NAMES)


@pytest.fixture(scope="module")
def learned():
    u = [[3.0, 1.0], [1.0, 2.5], [2.2, 1.4], [2.5, 0.5], [0.5, 2.0], [1.5, 1.2]]
    return MonotoneSet.empty(2).add(u, [True] * 3 + [False] * 3)


@pytest.fixture(scope="module")
def sides(traffic, order, learned):
    return (
        dominating_points(traffic, order, learned.minimal_crashes),
        dominating_points(traffic, order, learned.corners),
    )


@pytest.fixture(scope="module")
def proposal(traffic, sides):
    inner, outer = sides
    return mixed(0.5, shifted(traffic, inner), shifted(traffic, outer), traffic, 0.1)


def grid_integral(proposal):
    """Midpoint rule over all that matters of the box [-1, inf) x (-inf, 4]."""
    a, b = np.linspace(-1, 14, 1501), np.linspace(-9, 4, 1301)
    a, b = (a[1:] + a[:-1]) / 2, (b[1:] + b[:-1]) / 2
    x = np.stack(np.meshgrid(a, b), axis=-1).reshape(-1, 2)
    return np.exp(proposal.log_density(x)).sum() * 0.01 * 0.01


def test_the_density_integrates_to_one(traffic, sides, proposal):
    assert grid_integral(proposal) == pytest.approx(1, abs=1e-4)
    for points in sides:
        assert grid_integral(shifted(traffic, points)) == pytest.approx(1, abs=1e-4)


def test_an_untruncated_normalisation_would_be_noticed(traffic, sides):
    """Negative control: without the masses in the box the density does not integrate to one."""
    p = shifted(traffic, sides[1])
    wrong = Proposal(p.weights, p.means, p.covariances, p.lower, p.upper, np.zeros(len(p.weights)))
    assert grid_integral(wrong) < 0.95


def test_weights_average_to_one_both_ways(traffic, proposal):
    rng = np.random.default_rng(0)
    x = proposal.sample(40_000, rng)
    w = np.exp(traffic.log_density(x) - proposal.log_density(x))
    assert w.mean() == pytest.approx(1, abs=4 * w.std() / 200)
    y = traffic.sample(40_000, rng)
    v = np.exp(proposal.log_density(y) - traffic.log_density(y))
    assert v.mean() == pytest.approx(1, abs=5 * v.std() / 200)


def test_the_defensive_share_bounds_the_weights(traffic, proposal):
    x = np.random.default_rng(1).uniform([-1, -8], [12, 4], (20_000, 2))
    w = np.exp(traffic.log_density(x) - proposal.log_density(x))
    assert w.max() <= 10 * (1 + 1e-9)
    assert w.max() > 9


def test_draws_follow_the_density(proposal):
    """Each coordinate's distribution function by quadrature, against draws."""
    x = proposal.sample(4000, np.random.default_rng(2))
    a, b = np.linspace(-1, 14, 601), np.linspace(-9, 4, 521)
    a, b = (a[1:] + a[:-1]) / 2, (b[1:] + b[:-1]) / 2
    density = np.exp(
        proposal.log_density(np.stack(np.meshgrid(a, b), axis=-1).reshape(-1, 2))
    ).reshape(len(b), len(a))
    for k, (grid, marginal) in enumerate([(a, density.sum(axis=0)), (b, density.sum(axis=1))]):
        cumulative = np.cumsum(marginal) / marginal.sum()
        edges = grid + (grid[1] - grid[0]) / 2
        result = kstest(x[:, k], lambda v, e=edges, c=cumulative: np.interp(v, e, c))
        assert result.pvalue > 1e-3


def test_components_with_little_mass_in_the_box_are_drawn_exactly(traffic):
    far = Proposal.of_traffic(
        TrafficModel([1.0], [[-9.0, 0.0]], [np.eye(2)], traffic.lower, traffic.upper, NAMES)
    )
    x = far.sample(500, np.random.default_rng(0))
    assert (x[:, 0] >= -1).all()
    assert x[:, 0].mean() == pytest.approx(-1 + 1 / 8.12, abs=0.02)


def test_of_traffic_is_the_traffic_model(traffic):
    x = traffic.sample(200, 0)
    np.testing.assert_allclose(
        Proposal.of_traffic(traffic).log_density(x), traffic.log_density(x), rtol=1e-10
    )
    outside = np.array([[-1.1, 0.0], [0.0, 4.1]])
    assert (Proposal.of_traffic(traffic).log_density(outside) == -np.inf).all()


def test_shifted_weights_are_the_papers(traffic, sides):
    points = sides[1]
    p = shifted(traffic, points)
    for i in range(2):
        mine = points.component == i
        np.testing.assert_allclose(p.weights[mine], traffic.weights[i] / mine.sum())
        np.testing.assert_array_equal(p.covariances[mine][0], traffic.covariances[i])


def test_rho_is_the_share_of_the_inner_proposal(traffic, sides):
    inner, outer = (shifted(traffic, points) for points in sides)
    x = traffic.sample(50, 1)
    f, f_i, f_o = (np.exp(p.log_density(x)) for p in (traffic, inner, outer))
    got = np.exp(mixed(0.3, inner, outer, traffic, 0.2).log_density(x))
    np.testing.assert_allclose(got, 0.8 * (0.3 * f_i + 0.7 * f_o) + 0.2 * f, rtol=1e-9)


def test_missing_parts_leave_their_share_to_the_others(traffic, sides):
    outer = shifted(traffic, sides[1])
    x = traffic.sample(50, 1)
    only = mixed(0.5, None, outer, traffic, 0.2)
    expected = 0.8 * np.exp(outer.log_density(x)) + 0.2 * np.exp(traffic.log_density(x))
    np.testing.assert_allclose(np.exp(only.log_density(x)), expected, rtol=1e-9)
    alone = mixed(0.5, None, None, traffic, 0.2)
    np.testing.assert_allclose(alone.log_density(x), traffic.log_density(x), rtol=1e-9)


def test_rho_rules(traffic, order, sides):
    inner, outer = sides
    nothing = dominating_points(traffic, order, np.empty((0, 2)))
    assert shifted(traffic, nothing) is None
    assert learning_rho(nothing) == 0.0
    assert learning_rho(inner) == 0.5
    assert recommended_rho(inner, outer, traffic) == 0.5
    few = dominating_points(traffic, order, [[3.0, 1.0]])
    assert recommended_rho(few, outer, traffic) == 0.0
    far = dominating_points(traffic, order, [[9.0, 1.0], [8.0, 2.0], [7.0, 3.0]])
    assert separation(far, outer, traffic) > 1
    assert recommended_rho(far, outer, traffic) == 0.0
    assert separation(nothing, outer, traffic) == np.inf


def test_bad_shares_are_refused(traffic):
    for rho, share in ((-0.1, 0.1), (0.5, 0.0), (0.5, 1.1)):
        with pytest.raises(InvalidInputError, match="expected rho"):
            mixed(rho, None, None, traffic, share)
    p = Proposal.of_traffic(traffic)
    with pytest.raises(InvalidInputError, match="sum to 1"):
        blend([(0.5, p), (0.6, p)])
    with pytest.raises(InvalidInputError, match="number of draws"):
        p.sample(-1, np.random.default_rng(0))
