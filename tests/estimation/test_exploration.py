"""The search for the first crash and the crash set's edge."""

import numpy as np
import pytest

from crashrate.crash_set.order import RiskOrder
from crashrate.errors import InvalidInputError
from crashrate.estimation import exploration
from crashrate.estimation.exploration import (
    MAX_INFLATIONS,
    RUNS_PER_LINE,
    danger,
    explore,
    inflated,
)
from crashrate.estimation.labels import Labels
from crashrate.estimation.strategy import Problem
from crashrate.traffic.model import TrafficModel

pytestmark = pytest.mark.usefixtures("small")


def problem_of(case, risk="its own", **options):
    risk = case.risk if risk == "its own" else risk
    order = None if risk is None else RiskOrder.from_mapping(risk, case.traffic.names)
    return Problem(traffic=case.traffic, order=order, **options)


def test_danger_is_a_chain():
    u = np.random.default_rng(0).standard_normal((300, 2))
    rank = danger(u)
    above = (u[:, None] > u[None]).all(axis=2)
    i, j = np.nonzero(above)
    assert np.all(rank[i] > rank[j])


def test_inflated_has_every_component_at_every_size():
    traffic = TrafficModel(
        [0.9, 0.1], [[0.0], [3.0]], [[[1.0]], [[2.0]]], [-np.inf], [np.inf], ("a",)
    )
    got = inflated(traffic, (1.0, 4.0))
    assert got.weights.tolist() == [0.25] * 4
    assert got.covariances.ravel().tolist() == [1.0, 2.0, 4.0, 8.0]


@pytest.mark.parametrize("p", [1e-2, 1e-6])
def test_finds_the_edge_with_few_runs(cases, drive, p):
    case = cases.half_plane(p)
    found, queries = drive(explore(problem_of(case), 2), case.crash)
    assert found.found
    assert sum(len(q.x) > 1 for q in queries) <= 1  # the probes of the order come together
    assert found.labels.n < 50
    danger_of = found.labels.x.sum(axis=1) / np.sqrt(2)
    gap = danger_of[found.labels.y == 1].min() - danger_of[found.labels.y == 0].max()
    assert 0 < gap < 0.5
    assert found.labels.contradictions == 0


def test_edge_points_are_near_the_likeliest_crash(cases, drive):
    case = cases.half_plane(1e-6)
    labels = drive(explore(problem_of(case), 2), case.crash)[0].labels
    distance = np.linalg.norm(labels.crashes, axis=1)
    assert distance.min() < 4.7534 + 1.2  # the likeliest crash is 4.7534 from the centre


def test_without_an_order_space_is_filled_until_a_crash(cases, drive):
    case = cases.half_plane(1e-3)
    found, _ = drive(explore(problem_of(case, risk=None), 2), case.crash)
    assert found.found
    assert found.labels.learned is None


@pytest.mark.parametrize(("d", "p"), [(2, 1e-8), (3, 1e-9)])
def test_without_an_order_a_rare_half_space_is_found_in_a_few_runs(cases, drive, d, p):
    # most of the search leaves out the least dense 1e-7 of traffic, and would see nothing of it
    case = cases.half_plane(p, d=d)
    for seed in range(3):
        problem = problem_of(case, risk=None, seed=seed)
        found, _ = drive(explore(problem, 2), case.crash)
        first = int(np.argmax(found.labels.y == 1)) + 1
        assert found.labels.crashes.size
        assert first <= 15


def test_without_an_order_a_small_disc_is_found_sooner_off_the_border(cases, drive, monkeypatch):
    """Of probability 1e-6, at any angle: much of what traffic reaches is near the border of it."""

    def runs():
        return np.array([found_after(angle) for angle in np.arange(0.0, 2 * np.pi, 0.6)])

    def found_after(angle):
        center = 4.838 * np.array([np.cos(angle), np.sin(angle)])

        def disc(x):
            return (np.hypot(*(x - center).T) < 0.4035).astype(float)

        problem = problem_of(cases.half_plane(1e-6), risk=None)
        return drive(explore(problem, 2), disc)[0].n_filling

    monkeypatch.setattr(exploration, "N_WIDE", 20_000)
    off = runs()
    monkeypatch.setattr(exploration, "MAX_MESHED", 0)
    on = runs()
    assert off.mean() < on.mean() - 10
    assert (off < 200).sum() > (on < 200).sum()


def test_an_order_whose_most_dangerous_situations_are_safe_is_dropped(cases, drive):
    case = cases.disc()
    down = dict.fromkeys("ab", "decreasing")
    found, queries = drive(explore(problem_of(case, risk=down, max_calls=60), 2), case.crash)
    assert found.labels.learned is None
    assert len(queries) > MAX_INFLATIONS


def test_a_sliver_in_a_corner_is_found_and_its_edges_along_every_variable(drive):
    # "c" has no bound: the corner lies where all draws of inflated traffic end
    traffic = TrafficModel(
        [1.0], np.zeros((1, 3)), np.eye(3)[None], [-9.0] * 3, [3.0, 2.0, np.inf], ("a", "b", "c")
    )
    edges = np.array([2.99, 1.5, 12.0])
    problem = Problem(
        traffic=traffic,
        order=RiskOrder.from_mapping(dict.fromkeys("abc", "increasing"), traffic.names),
    )
    found, _ = drive(explore(problem, 2), lambda x: (x >= edges).all(axis=1))
    assert found.found
    assert found.labels.n <= MAX_INFLATIONS + 1 + 5 * RUNS_PER_LINE + 60
    crashes, safe = found.labels.crashes, found.labels.x[found.labels.y == 0]
    for i, edge in enumerate(edges):
        others = np.delete(np.arange(3), i)
        along = safe[(safe[:, others] >= edges[others]).all(axis=1)]
        assert len(along)
        assert (along[:, i] < edge).all()
    assert (crashes.min(axis=0) < np.array([3.01, 1.7, 24.0])).all()


@pytest.mark.parametrize("max_calls", [1, 2, 5, 9, 14])
@pytest.mark.parametrize("ordered", [True, False])
def test_keeps_to_the_budget(cases, drive, max_calls, ordered):
    case = cases.half_plane(1e-4)
    risk = case.risk if ordered else None
    found, _ = drive(explore(problem_of(case, risk=risk, max_calls=max_calls), 2), case.crash)
    assert found.labels.n <= max_calls


def test_common_crashes_leave_no_ordinary_draws_for_safe(cases, drive):
    case = cases.half_plane(0.3)
    found, _ = drive(explore(problem_of(case), 2), case.crash)
    assert len(found.ordinary) == 0
    rare = cases.half_plane(1e-6)
    found, _ = drive(explore(problem_of(rare), 2), rare.crash)
    assert len(found.ordinary) > 0
    assert not rare.crash(found.ordinary).any()


def test_failed_simulations_do_not_end_the_search(cases, drive):
    case = cases.half_plane(1e-4)
    calls = iter(range(10**6))

    def simulate(x):
        return np.where(next(calls) % 3 == 2, np.nan, case.crash(x))

    found, _ = drive(explore(problem_of(case), 2), simulate)
    assert found.found
    assert np.isnan(found.labels.y).any()


def test_labels_without_order_imply_nothing(cases):
    problem = problem_of(cases.half_plane(0.1))
    labels = Labels.empty(problem).add(np.array([[1.0, 1.0]]), np.array([1.0]))
    above = np.array([[2.0, 2.0]])
    assert labels.implied(above)[0].tolist() == [True]
    assert labels.without_order().implied(above)[0].tolist() == [False]
    assert labels.without_order().contradictions == 0


def test_a_coordinate_that_is_infinite_on_a_bound_is_not_tried_there(drive):
    """A range bounded at 0, over which a coordinate is taken, and a vehicle that never crashes."""
    traffic = TrafficModel(
        [1.0], [[0.2, 0.05]], [np.diag([0.01, 0.0004])], [0.0, 0.0], [2.0, 1.0], ("ttc_", "r_")
    )
    order = RiskOrder.from_mapping(
        {"closing": (lambda x: x[:, 0] / x[:, 1], "increasing")}, traffic.names
    )
    problem = Problem(traffic=traffic, order=order, max_calls=30)
    found, _ = drive(explore(problem, 2), lambda x: np.zeros(len(x)))
    assert not found.found


def test_inflated_is_no_wider_than_half_the_box():
    traffic = TrafficModel([1.0], [[0.5]], [[[100.0]]], [0.0], [1.0], ("a",))
    got = inflated(traffic, (1.0, 4.0))
    assert np.allclose(np.sqrt(got.covariances.ravel()), 0.5)


def test_a_coordinate_of_wildly_uneven_values_is_refused_before_any_run(cases):
    def wild(x):
        return np.exp(8 * x[:, 0])

    risk = {"wild": (wild, "increasing"), "b": "increasing"}
    with pytest.raises(InvalidInputError, match=r"'wild': expected .* such as its logarithm"):
        cases.half_plane(1e-6).campaign(risk=risk).ask()
    tame = {"tame": (lambda x: np.exp(x[:, 0]), "increasing"), "b": "increasing"}
    study = cases.half_plane(1e-4).estimate(risk=tame, relative_half_width=0.3)
    assert study.interval[0] <= 1e-4 <= study.interval[1]
