"""What is held about a pool's draws."""

from dataclasses import replace

import numpy as np
import pytest

from crashrate.crash_set.order import RiskOrder
from crashrate.crash_set.surrogate import Prior, fit_surrogate
from crashrate.estimation.labels import Labels, n_to_discard
from crashrate.estimation.strategy import Problem
from crashrate.estimation.view import MIN_SCALE, ROUGH_POWER, Standardiser, normalised, see
from crashrate.sampling.pool import draw_pool

PRIOR = Prior(bump=0.5, length=2.0, variance=1e3, linear=1.0, slope=1.0, constant=0.0)
AS_IS = Standardiser(np.zeros(2), np.ones(2), np.ones(2))


def labelled(case, x, y, *, ordered=True):
    order = RiskOrder.from_mapping(case.risk, case.traffic.names) if ordered else None
    return Labels.empty(Problem(traffic=case.traffic, order=order)).add(np.array(x), np.array(y))


def looked_at(case, labels, n=4000, standardise=AS_IS):
    """A pool of `case` seen through `labels` and a surrogate fitted to them."""
    pool = draw_pool(case.traffic, case.traffic, labels.coordinates, n, np.random.default_rng(0))
    return see(
        pool, labels, fit_surrogate(standardise(labels.u), labels.y == 1, PRIOR), standardise
    )


def test_standardiser_has_weighted_moments():
    rng = np.random.default_rng(0)
    u, weights = rng.normal(3, 2, (500, 2)), rng.random(500)
    z = Standardiser.weighted(u, weights / weights.sum())(u)
    assert weights @ z == pytest.approx([0, 0], abs=1e-9)
    assert weights @ z**2 / weights.sum() == pytest.approx([1, 1])


def test_standardiser_keeps_the_pool_within_reach():
    u = np.concatenate([np.linspace(-3, 3, 99), [1.0, 1.0 + 1e-9]])[:, None]
    weights = np.concatenate([np.zeros(99), [0.5, 0.5]])
    assert np.abs(Standardiser.weighted(u, weights)(u)).max() < 10 / MIN_SCALE


def test_where_runs_teach_most_does_not_move_the_unit_of_what_is_deep(cases, monkeypatch):
    """In units as narrow as the learning runs lie a vehicle's ripples would refute its order."""
    from crashrate.estimation import view as module

    case = cases.half_plane(1e-3)
    labels = labelled(case, [[3.0, 3.0], [1.5, 1.5]], [1, 0])
    seen = []
    for density in (0.2, 0.8):
        monkeypatch.setattr(module, "LEARN_DENSITY", density)
        view = looked_at(case, labels)
        seen.append(Standardiser.weighted(view.pool.u, view.learning, view.breadth))
    wide, narrow = seen
    assert np.array_equal(wide.unit, narrow.unit)
    assert np.all(narrow.scale < 0.9 * wide.scale)


def test_coordinates_that_stay_take_the_new_unit():
    before = Standardiser(np.zeros(2), np.ones(2), np.ones(2))
    near = Standardiser(np.full(2, 0.1), np.ones(2), np.full(2, 3.0))
    kept = before.or_else(near)
    assert np.array_equal(kept.center, before.center)
    assert np.array_equal(kept.unit, near.unit)
    assert before.or_else(replace(near, unit=np.full(2, 1.1))) is before
    far = replace(near, center=np.ones(2))
    assert before.or_else(far) is far


def test_order_decides_and_the_rest_is_the_surrogates(cases):
    case = cases.half_plane(0.2)
    labels = labelled(case, [[0.8, 0.8], [-0.5, -0.5]], [1, 0])
    view = looked_at(case, labels)
    above = (view.pool.x >= 0.8).all(axis=1)
    below = (view.pool.x <= -0.5).all(axis=1)
    assert np.array_equal(view.implied_inner, above)
    assert np.array_equal(view.implied_safe, below)
    assert np.array_equal(view.inner | view.safe, ~view.undecided)
    assert view.h[view.inner].min() >= 0.9
    assert view.h[view.safe].max() <= 0.1
    assert view.h[view.undecided] == pytest.approx(view.surrogate_h[view.undecided], abs=0.05)
    assert np.all((view.surrogate_h > 0) & (view.surrogate_h < 1))


def test_an_implied_outcome_is_open_where_the_surrogate_objects(cases):
    case = cases.half_plane(0.2)
    labels = labelled(case, [[0.0, 0.0], [1.0, 1.0], [1.2, 0.8]], [1, 0, 0])
    without = labelled(case, [[0.0, 0.0]], [1])
    view = see(
        looked_at(case, without).pool,
        without,
        fit_surrogate(labels.u, labels.y == 1, PRIOR),
        AS_IS,
    )
    objected = view.implied_inner & (view.surrogate_h < 0.5)
    assert objected.any()
    assert not view.inner[objected].any()
    assert view.h[objected].max() <= 0.5


def test_bounds_hold_the_exact_probability(cases):
    case = cases.half_plane(0.2)
    x = case.traffic.sample(60, 1)
    view = looked_at(case, labelled(case, x, case.crash(x)), n=20_000)
    low, high = view.bounds()
    assert 0.05 < low < 0.2 < high < 0.5


def test_without_an_order_the_far_is_taken_as_safe(cases):
    case = cases.half_plane(0.2)
    x = case.traffic.sample(80, 1)
    view = looked_at(case, labelled(case, x, case.crash(x), ordered=False))
    assert not view.inner.any()
    assert not view.safe.any()
    assert view.h[view.surrogate_h < 1e-3].max() < 1e-9
    assert view.bounds() == (0.0, pytest.approx(1.0, abs=1e-9))


def test_a_failed_simulation_implies_nothing(cases):
    case = cases.half_plane(0.2)
    labels = labelled(case, [[0.8, 0.8], [-0.5, -0.5]], [np.nan, np.nan])
    assert not any(part.any() for part in labels.implied(case.traffic.sample(100, 2)))
    assert labels.known.tolist() == [False, False]


def test_pool_variance_is_that_of_many_pools(toy_view):
    seen, predicted = [], []
    for seed in range(400):
        view, _ = toy_view(np.random.default_rng(seed))
        crash = view.pool.x.sum(axis=1) > 2
        known = replace(view, h=crash.astype(float))
        seen.append(known.probability)
        predicted.append(known.pool_variance)
    assert np.mean(predicted) == pytest.approx(np.var(seen), rel=0.25)


def test_distributions_over_draws(toy_view):
    view, _ = toy_view(np.random.default_rng(1))
    for distribution in (view.learning, view.target):
        assert distribution.sum() == pytest.approx(1)
        assert distribution.min() >= 0
    ratio = view.target[1] / view.target[0]
    expected = np.sqrt(view.h[1] / view.h[0]) * view.weights[1] / view.weights[0]
    assert ratio == pytest.approx(expected)
    assert normalised(np.zeros(4)).tolist() == [0.25] * 4


def test_draws_are_flatter_at_a_rough_edge(toy_view):
    view, _ = toy_view(np.random.default_rng(1))
    assert np.array_equal(view.drawing, view.spread)
    drawn = replace(view, rough=True).drawing
    open_ = view.spread > 0
    flattened = np.log(drawn[open_] / view.weights[open_])
    assert flattened == pytest.approx(
        ROUGH_POWER * np.log(view.spread[open_] / view.weights[open_])
    )
    assert not drawn[~open_].any()


@pytest.mark.parametrize(
    ("ordered", "outcomes", "expected"),
    [(True, [1, 0], True), (True, [0, 1], False), (False, [1, 0], False)],
)
def test_an_edge_is_rough_where_outcomes_contradict_the_order(cases, ordered, outcomes, expected):
    at = [[0.0, 0.0], [1.0, 1.0]]
    case = cases.half_plane(0.2)
    assert looked_at(case, labelled(case, at, outcomes, ordered=ordered)).rough == expected


def test_contradicted_outcomes_are_presumed_where_no_other_says_the_opposite(cases):
    # the safe (1, 1) contradicts the crash (0, 0), which implies nothing for certain any more
    labels = labelled(cases.half_plane(0.2), [[0.0, 0.0], [1.0, 1.0]], [1, 0])
    u = np.array([[2.0, 0.5], [2.0, 2.0], [0.5, 0.5], [-1.0, -1.0], [-1.0, 0.5], [-1.0, 2.0]])
    crash, safe = labels.presumed(u)
    assert crash.tolist() == [True, True, False, False, False, False]
    assert safe.tolist() == [False, False, False, True, True, False]
    implied_crash, implied_safe = labels.implied(u)
    assert not (implied_crash | implied_safe).any()


def test_contradictions_are_as_deep_as_their_least_coordinate(cases):
    at = [[0.0, 0.0], [0.3, 1.0], [0.2, 0.1], [-3.0, 5.0]]
    labels = labelled(cases.half_plane(0.2), at, [1, 0, 0, 1])
    assert labels.contradiction_gaps(np.ones(2)) == pytest.approx(np.array([[0.3, 0.1]]))
    scaled = labels.contradiction_gaps(np.array([0.1, 1.0]))
    assert scaled == pytest.approx(np.array([[1.0, 0.1]]))
    assert not labels.without_order().contradiction_gaps(np.ones(2)).size
    agreeing = labelled(cases.half_plane(0.2), at[:2], [0, 1])
    assert not agreeing.contradiction_gaps(np.ones(2)).size


def test_a_hole_is_a_safe_outcome_above_a_crash(cases):
    at = [[0.0, 0.0], [1.0, 1.0], [2.0, 2.0], [0.02, 0.02], [-1.0, -1.0]]
    labels = labelled(cases.half_plane(0.2), at, [1, 0, 1, 1, 0])
    assert labels.exceptions(np.array([0.05, 0.05])) == (1, 2)
    assert labels.exceptions(np.array([1.5, 1.5])) == (0, 1)
    assert labels.without_order().exceptions(np.array([0.05, 0.05])) == (0, 0)
    agreeing = labelled(cases.half_plane(0.2), at[:1] + at[2:], [1, 1, 1, 0])
    assert agreeing.exceptions(np.array([0.05, 0.05])) == (0, 0)


def test_one_crash_below_many_safe_outcomes_makes_no_holes(cases):
    at = [[-5.0, -5.0], *([v, v] for v in (0.1, 0.2, 0.3, 0.4)), [3.0, 3.0]]
    labels = labelled(cases.half_plane(0.2), at, [1, 0, 0, 0, 0, 1])
    assert labels.exceptions(np.array([0.05, 0.05])) == (0, 0)


def test_holes_leave_a_doubt_about_what_the_order_implies(cases):
    case = cases.half_plane(0.2)
    at = [[v, v] for v in (0.7, 1.0, 1.3, 1.6, 1.9, 2.2)] + [[-1.0, -1.0], [0.4, 0.4]]
    whole = looked_at(case, labelled(case, at, [1] * 6 + [0, 0]))
    holed = looked_at(case, labelled(case, at, [1, 1, 0, 1, 1, 1, 0, 0]))
    far = (whole.pool.u > 1.5).all(axis=1)
    assert far.any()
    assert (whole.h[far] == 1).all()
    assert holed.inner[far].any()
    assert (holed.h[far & holed.inner] <= 1 - 1 / 5).all()


def test_a_ripple_is_no_hole(cases):
    case = cases.half_plane(0.2)
    at = [[v, v] for v in (0.7, 1.0, 1.3, 1.6, 1.9, 2.2)] + [[-1.0, -1.0], [0.4, 0.4]]
    labels = labelled(case, at, [1, 1, 0, 1, 1, 1, 0, 0])
    hole = looked_at(case, labels)
    ripple = looked_at(case, labels, standardise=replace(AS_IS, unit=np.full(2, 20.0)))
    assert hole.h.max() == 1 - 1 / 5
    assert ripple.h.max() == 1


def test_margin_asks_for_more_than_an_outcome_beyond_another(cases):
    labels = labelled(cases.half_plane(0.2), [[0.0, 0.0], [-1.0, -1.0]], [1, 0])
    u = np.array([[0.05, 2.0], [0.15, 0.15], [-1.05, -1.05], [-1.2, -1.2]])
    deep = labels.implied_deep(u, np.array([0.1, 0.1]))
    assert deep.tolist() == [False, True, False, True]


def test_contradicted_outcomes_vouch_for_nothing_at_depth(cases):
    labels = labelled(cases.half_plane(0.2), [[0.0, 0.0], [1.0, 1.0]], [1, 0])
    assert labels.presumed(np.array([[5.0, 5.0]]))[0].all()
    assert not labels.implied_deep(np.array([[5.0, 5.0], [-5.0, -5.0]]), np.zeros(2)).any()


def test_one_wrong_outcome_is_discarded_once():
    star, pairs = np.zeros((6, 9), bool), np.eye(4, dtype=bool)
    star[2] = True
    assert n_to_discard(star) == 1
    assert n_to_discard(pairs) == 4
    assert n_to_discard(np.ones((3, 7), bool)) == 3
    assert n_to_discard(np.zeros((0, 0), bool)) == 0


@pytest.mark.parametrize("ripple", [0.2, 0.4])
def test_doubt_reaches_as_deep_as_the_contradictions_seen(cases, ripple):
    # crashes and safe outcomes along both sides of a + b = 0, and one pair `ripple` deep
    t = np.linspace(-2, 2, 81)
    edge = np.stack([t, -t], axis=1)
    pair = np.array([[-3.0, 3.0], [-3.0 + ripple, 3.0 + ripple]])
    x = np.concatenate([edge + 0.02, edge - 0.02, pair])
    y = np.array([1] * 81 + [0] * 81 + [1, 0])
    labels = labelled(cases.half_plane(0.2), x, y)
    view = looked_at(cases.half_plane(0.2), labels, n=20_000)
    doubted = (view.inner | view.safe) & (view.h > 1e-3) & (view.h < 1 - 1e-3)
    u = view.pool.u[doubted][:, None]
    above, below = (u - x[y == 1]).min(axis=2).max(axis=1), (x[y == 0] - u).min(axis=2).max(axis=1)
    depth = np.maximum(above, below)[np.abs(u).max(axis=(1, 2)) < 2.0].max()  # away from the pair
    assert 0.8 * ripple < depth <= ripple + 1e-9


def oblique(n, thin, seed=0):
    """Coordinates (n, 2) spread along one diagonal, and `thin` times as far along the other."""
    z = np.random.default_rng(seed).standard_normal((n, 2)) * [1.0, thin]
    return z @ np.array([[1.0, 1.0], [1.0, -1.0]]) + [3.0, -2.0]


def ratio(z):
    return np.sqrt(np.linalg.cond(np.cov(z.T)))


def test_a_thin_oblique_spread_is_made_round_where_no_order_forbids_it():
    u, even = oblique(4000, 0.2), np.full(4000, 1 / 4000)
    assert ratio(Standardiser.weighted(u, even, free=True)(u)) == pytest.approx(1, rel=0.01)
    assert ratio(Standardiser.weighted(u, even)(u)) == pytest.approx(5, rel=0.05)
    # the thinnest is stretched, not blown up; what is hardly thin, or hardly known, stays
    thinnest = oblique(4000, 1e-4)
    assert 100 < ratio(Standardiser.weighted(thinnest, even, free=True)(thinnest)) < 5000
    assert Standardiser.weighted(oblique(4000, 0.6), even, free=True).mix is None
    assert Standardiser.weighted(u[:15], np.full(15, 1 / 15), free=True).mix is None


def test_round_coordinates_stay_while_they_hardly_change():
    even = np.full(4000, 1 / 4000)
    first = Standardiser.weighted(oblique(4000, 0.2), even, free=True)
    again = Standardiser.weighted(oblique(4000, 0.2, seed=1), even, free=True)
    assert first.or_else(again) is first
    turned = replace(first, mix=first.mix @ np.array([[0.6, 0.8], [-0.8, 0.6]]))
    assert first.or_else(turned) is first  # kernels are round
    thinner = Standardiser.weighted(oblique(4000, 0.13), even, free=True)
    assert first.or_else(thinner) is thinner
    flat = replace(first, mix=None)
    assert flat.or_else(first) is first
    assert first.or_else(flat) is flat
