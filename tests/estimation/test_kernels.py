"""The surrogate's kernels and the labels it is fitted to."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr

from crashrate.crash_set.order import RiskOrder
from crashrate.crash_set.surrogate import Prior, fit_surrogate
from crashrate.estimation import kernels, telling
from crashrate.estimation.kernels import ADDITIVE, KERNELS, N_RIVALS, SHAPES, SOFT, Kernel, Model
from crashrate.estimation.labels import Labels
from crashrate.estimation.strategy import Problem
from crashrate.estimation.view import FAR, Standardiser

NONE = np.empty((0, 2))
AS_IS = Standardiser(np.zeros(2), np.ones(2), np.ones(2))
ANY = fit_surrogate(
    np.zeros((1, 2)), np.ones(1, bool), Prior(0.5, 1.0, 1.0, linear=1.0, slope=1.0, constant=0.0)
)


def labelled(cases, n, crash, *, ordered=True, seed=0):
    case = cases.half_plane(0.2)
    order = RiskOrder.from_mapping(case.risk, case.traffic.names) if ordered else None
    x = np.random.default_rng(seed).standard_normal((n, 2))
    return Labels.empty(Problem(traffic=case.traffic, order=order)).add(x, crash(x))


def smooth(x):
    return (x[:, 0] + 0.5 * x[:, 1] ** 2 > 0.5).astype(float)


def test_many_labels_are_thinned_to_the_telling_ones(cases, monkeypatch):
    monkeypatch.setattr(telling, "MAX_LABELS", 150)
    monkeypatch.setattr(telling, "MIN_OLD", 100)
    first = labelled(cases, 150, smooth)
    _, model = Model(AS_IS).fit(first, NONE, directed=True)
    more = first.add(x := np.random.default_rng(1).standard_normal((40, 2)), smooth(x))
    thinned, after = model.fit(more, NONE, directed=True)
    assert len(thinned.u) == 150
    assert {tuple(u) for u in x} <= {tuple(u) for u in thinned.u}
    monkeypatch.setattr(telling, "MAX_LABELS", 1000)
    whole, _ = model.fit(more, NONE, directed=True)
    at = np.random.default_rng(2).standard_normal((500, 2))
    change = np.abs(thinned.predict(at).probability - whole.predict(at).probability)
    assert change.mean() < 0.01
    # as many labels taken at random are worse, and the sites of all labels are kept
    assert len(dict(after.warm)[after.best].tau) == 190
    lottery = labelled(cases, 150, smooth, seed=7)
    by_lot, _ = Model(AS_IS).fit(lottery, NONE, directed=True)
    assert np.abs(by_lot.predict(at).probability - whole.predict(at).probability).mean() > 0.01


def test_labels_that_come_all_at_once_are_thinned_too(cases, monkeypatch):
    monkeypatch.setattr(telling, "MAX_LABELS", 150)
    monkeypatch.setattr(telling, "MIN_OLD", 100)
    many = labelled(cases, 1200, smooth)
    thinned, model = Model(AS_IS).fit(many, NONE, directed=True)
    assert len(thinned.u) == 150
    assert not np.isnan(dict(model.warm)[model.best].tau).any()
    again, _ = model.fit(many.add(np.zeros((1, 2)), np.zeros(1)), NONE, directed=True)
    assert len(again.u) == 150
    at = np.random.default_rng(2).standard_normal((500, 2))
    truth = smooth(at) == 1
    lottery, _ = Model(AS_IS).fit(labelled(cases, 150, smooth, seed=7), NONE, directed=True)

    def wrong(fit):
        return np.abs(fit.predict(at).probability - truth).mean()

    assert wrong(thinned) < 0.5 * wrong(lottery)
    assert wrong(again) < 0.5 * wrong(lottery)


def test_soft_kernels_join_where_outcomes_contradict_an_order_deeply(cases, monkeypatch):
    tried = []
    fit = telling.fit_surrogate

    def spy(u, crash, prior, warm):
        tried.append(prior.variance)
        return fit(u, crash, prior, warm)

    monkeypatch.setattr(telling, "fit_surrogate", spy)
    rng = np.random.default_rng(3)

    def luck(x):
        return (x.sum(axis=1) + rng.standard_normal(len(x)) > 1).astype(float)

    def monotone(x):
        return (x.sum(axis=1) > 1).astype(float)

    Model(AS_IS).fit(labelled(cases, 60, monotone), NONE, directed=True)
    assert len(tried) == len(KERNELS + ADDITIVE)
    tried.clear()
    fitted, _ = Model(AS_IS).fit(labelled(cases, 60, luck), NONE, directed=True)
    assert len(tried) == len(KERNELS + ADDITIVE + SOFT)
    assert fitted.converged


def test_kernels_are_chosen_anew_where_labels_grew_or_it_is_asked_for(cases, monkeypatch):
    monkeypatch.setattr(kernels, "REFIT_ALWAYS", 0)
    labels = labelled(cases, 60, smooth)
    _, model = Model(AS_IS).fit(labels, NONE, directed=True)
    # as if the kernel that fits worst had been chosen
    model = replace(model, best=SOFT[0], n_chosen=55)
    stays, _ = model.fit(labels, NONE, directed=True)
    again, _ = model.fit(labels, NONE, directed=True, again=True)
    grown, _ = replace(model, n_chosen=50).fit(labels, NONE, directed=True)
    assert stays.prior.variance == SOFT[0].variance
    assert again.prior == grown.prior
    assert again.prior.variance > stays.prior.variance
    monkeypatch.setattr(kernels, "MANY", 60)  # of many labels: after longer growth
    model = replace(model, n_chosen=50)
    assert model.fit(labels, NONE, directed=True)[0].prior == stays.prior
    assert replace(model, n_chosen=40).fit(labels, NONE, directed=True)[0].prior == again.prior


@pytest.mark.parametrize("bump", [0.1, 3.0])
def test_far_from_every_run_is_safe_without_an_order_whatever_the_kernel(bump):
    prior = kernels._prior(Kernel(bump, 1.0, 1e4), 2, directed=False)
    far = np.array([[2.0, 2.0], [20.0, -20.0]])
    deviations = prior.mean(far) / np.sqrt(prior.variances(far))
    assert (ndtr(deviations) < FAR).all()


@pytest.mark.parametrize("shape", SHAPES)
def test_the_other_side_of_traffic_is_safe_where_crashes_lie_in_a_small_disc(cases, shape):
    """Where coordinates are scaled to a disc most of traffic is far: a plane could rise there."""
    center, rng = np.array([4.6, 1.5]), np.random.default_rng(2)

    def disc(x):
        return (np.hypot(*(x - center).T) < 0.4).astype(float)

    x = np.concatenate([rng.standard_normal((30, 2)), center + 0.4 * rng.standard_normal((40, 2))])
    labels = Labels.empty(Problem(traffic=cases.half_plane(0.2).traffic)).add(x, disc(x))
    scaled = Standardiser(center, np.full(2, 0.25), np.full(2, 0.25))
    kernel = Kernel(*shape, 1e4)
    fits = Model(scaled)._fits(labels, NONE, (kernel,), directed=False)
    h = fits[kernel][0].predict(scaled(rng.standard_normal((5000, 2)) - [1.0, 0.5])).probability
    assert (h < FAR).all()


def test_inference_that_oscillates_is_no_candidate_where_soft_kernels_are():
    def fit(score, *, converged):
        return replace(ANY, log_score=score, converged=converged)

    better, worse = fit(-10.0, converged=False), fit(-20.0, converged=True)
    assert kernels._merit(better, soft=True) < kernels._merit(worse, soft=True)
    assert kernels._merit(better, soft=False) > kernels._merit(worse, soft=False)


def test_rivals_have_other_shapes_the_best_first(cases):
    labels = labelled(cases, 60, smooth)
    surrogate, model = Model(AS_IS).fit(labels, NONE, directed=True)
    rivals = model.rivals(labels, NONE, directed=True)
    assert len(rivals) == N_RIVALS
    assert rivals[0].log_score >= rivals[1].log_score
    shapes = {(r.prior.bump, r.prior.length, r.prior.additive) for r in (surrogate, *rivals)}
    assert len(shapes) == 1 + N_RIVALS
    assert rivals[0].log_score <= surrogate.log_score
