"""Held-out likelihood: honest splits, and the right number of components."""

import numpy as np
import pytest

from crashrate.errors import NumericalError
from crashrate.traffic.components import select_components
from crashrate.traffic.held_out import held_out_events, held_out_gains, held_out_score
from crashrate.traffic.mixture import TruncatedGaussianMixture
from crashrate.traffic.model import TrafficModel

BOX = {"lower": [0.0, -np.inf]}


def law(n_components):
    centres = [[1.0, 0.0], [9.0, 3.0], [4.0, -8.0]][:n_components]
    return TrafficModel(
        np.full(n_components, 1 / n_components), centres, [np.eye(2)] * n_components,
        [0.0, -np.inf], [np.inf] * 2, ["a", "b"],
    )  # fmt: skip


def test_a_split_holds_out_a_fifth_and_depends_on_its_seed():
    x = law(3).sample(20_000, 0)
    first, second = held_out_events(x, 1), held_out_events(x, 2)
    assert first.mean() == pytest.approx(0.2, abs=0.01)
    assert (first & second).mean() == pytest.approx(0.04, abs=0.005)  # independent of each other
    assert np.array_equal(first, held_out_events(x, 1))


def test_equal_events_lie_in_one_part_wherever_they_stand():
    x = np.round(law(3).sample(2000, 0))
    part = held_out_events(x, 1)
    order = np.random.default_rng(2).permutation(len(x))
    assert np.array_equal(held_out_events(x[order], 1), part[order])
    seen, unseen = ({tuple(row + 0.0) for row in x[which]} for which in (~part, part))
    assert seen
    assert unseen
    assert not seen & unseen
    assert len(np.unique(held_out_events(np.array([[0.0, 1.0], [-0.0, 1.0]]), 1))) == 1


def test_a_warm_start_leaks_nothing():
    """Against a cold fit that never saw the held-out events, where there is one hill to climb."""
    x = law(1).sample(300, 0)
    full = TruncatedGaussianMixture(1, **BOX).fit(x)
    for seed in range(3):
        out = held_out_events(x, seed)
        cold = TruncatedGaussianMixture(1, **BOX).fit(x[~out]).score(x[out])
        warm = held_out_score(full.model_, x, BOX, seed)
        assert warm == pytest.approx(cold, abs=1e-5)
        assert abs(full.score(x[out]) - cold) > 1e-4  # the control: a fit that saw them differs


def test_held_out_events_find_the_number_of_components():
    x = law(3).sample(3000, 0)
    found = select_components(x, [1, 2, 3, 4, 5], n_restarts=2, **BOX)
    assert found.held_out.shape == (5, 2)
    middle = np.median(held_out_gains(found.held_out), axis=1)
    assert middle[1] - middle[0] > 100
    assert middle[2] - middle[1] > 100
    assert np.abs(middle[3:] - middle[2]).max() < 10  # flat: two hundredths of the last step
    assert found.n_components == 3


def test_what_too_many_components_learn_by_heart_is_lost_on_held_out_events():
    x = law(2).sample(200, 3)
    # hardly any prior: it would keep components apart from what they could learn
    found = select_components(x, [2, 8], n_restarts=2, prior_strength=0.01, **BOX)
    gains = held_out_gains(found.held_out)
    assert found.log_likelihood[1] > found.log_likelihood[0]
    assert (gains[1] < gains[0]).all()


def test_a_single_number_of_components_holds_nothing_out():
    found = select_components(law(1).sample(100, 0), [2], **BOX)
    assert found.held_out.shape == (1, 0)
    assert found.traffic_model().provenance["selection"]["held_out"] == []


def test_gains_are_free_of_what_a_split_does_to_all():
    scores = np.array([[-3.0, -3.5], [-1.0, -1.5], [-1.01, -1.51]])
    gains = held_out_gains(scores + np.array([0.0, 7.0]))
    assert gains[:, 0] == pytest.approx(gains[:, 1])
    assert gains[:, 0] == pytest.approx([-2000, 0, -10])


def test_gains_of_missing_scores_are_missing():
    gains = held_out_gains([[None, -2.0], [-1.0, -1.5], [None, None]])
    assert np.isnan(gains).tolist() == [[True, False], [False, False], [True, True]]
    assert np.isnan(held_out_gains([[None], [None]])).all()
    assert held_out_gains([[], []]).shape == (2, 0)


def test_a_part_that_cannot_be_fitted_has_no_score(monkeypatch):
    x = law(1).sample(50, 0)
    model = TruncatedGaussianMixture(1, **BOX).fit(x).model_

    def collapse(*_):
        raise NumericalError("collapsed")

    monkeypatch.setattr(TruncatedGaussianMixture, "fit", collapse)
    assert np.isnan(held_out_score(model, x, BOX, 0))
    assert np.isnan(held_out_score(model, x[:0], BOX, 0))
