"""Fits to re-weighted events, and the models that carry them as members."""

import numpy as np
import pytest

from crashrate.errors import InvalidInputError
from crashrate.traffic import ensemble
from crashrate.traffic.ensemble import (
    Task,
    event_weights,
    fit_task,
    fit_tasks,
    member_tasks,
    with_members,
)
from crashrate.traffic.mixture import TruncatedGaussianMixture
from crashrate.traffic.model import TrafficModel

BOX = {"lower": [0.0, -np.inf]}


def law(shift=0.0):
    return TrafficModel(
        [0.7, 0.3], [[1.0 + shift, 0.0], [4.0, 2.0]], [np.eye(2), 0.5 * np.eye(2)],
        [0.0, -np.inf], [np.inf] * 2, ["a", "b"],
    )  # fmt: skip


@pytest.fixture(scope="module")
def events():
    return law().sample(800, 0)


def started(**options):
    """A mixture whose start does not depend on the events."""
    return TruncatedGaussianMixture(
        2, **BOX, weights_init=[0.5, 0.5], means_init=[[1.0, 0.0], [4.0, 2.0]],
        precisions_init=[np.eye(2)] * 2, tol=1e-10, **options,
    )  # fmt: skip


def test_weights_count_as_repetitions(events):
    times = np.random.default_rng(1).integers(1, 4, len(events))
    options = {"prior_strength": 0.0, "random_state": 0}
    weighted = started(**options).fit_weighted(events, times)
    repeated = started(**options).fit(np.repeat(events, times, axis=0))
    assert weighted.log_likelihood_ == pytest.approx(repeated.log_likelihood_, rel=1e-8)
    assert weighted.bic_ == pytest.approx(repeated.bic_, rel=1e-8)
    assert weighted.means_ == pytest.approx(repeated.means_, abs=1e-3)


def test_an_event_of_weight_zero_does_not_count(events):
    odd = np.vstack([events, [[9.0, -9.0]]])
    options = {"prior_strength": 0.0, "random_state": 0}
    weighted = started(**options).fit_weighted(odd, np.r_[np.ones(len(events)), 0.0])
    assert weighted.log_likelihood_ == pytest.approx(started(**options).fit(events).log_likelihood_)


@pytest.mark.parametrize(
    "weights", [[1.0], np.full(800, -1.0), np.zeros(800), np.full(800, np.nan)]
)
def test_bad_weights_are_refused(events, weights):
    with pytest.raises(InvalidInputError, match="weights: expected 800 finite numbers >= 0"):
        TruncatedGaussianMixture(1, **BOX).fit_weighted(events, weights)


def test_bootstrap_weights_are_exponential_and_add_up():
    weights = event_weights(20_000, 3)
    assert weights.sum() == pytest.approx(20_000)
    assert weights.std() == pytest.approx(1.0, abs=0.05)
    assert np.mean(weights > 1) == pytest.approx(np.exp(-1), abs=0.02)
    assert np.array_equal(weights, event_weights(20_000, 3))


def test_members_take_the_admissible_numbers_in_turn_and_a_seed_each():
    tasks = member_tasks(5, (3, 4), 0)
    assert [t.n_components for t in tasks] == [3, 4, 3, 4, 3]
    assert len({t.seed for t in tasks}) == len({t.bootstrap for t in tasks}) == 5
    assert member_tasks(3, (3, 4), 0) == tasks[:3]
    assert member_tasks(5, (3, 4), 1) != tasks
    with pytest.raises(InvalidInputError, match="at least one number of components"):
        member_tasks(5, (), 0)


def test_results_do_not_depend_on_the_number_of_workers(events):
    tasks = member_tasks(3, (1, 2), 7)
    alone, together = (fit_tasks(tasks, events, BOX, workers=n) for n in (1, 2))
    assert [f.model for f in alone] == [f.model for f in together]
    assert [f.bic for f in alone] == [f.bic for f in together]
    with pytest.raises(InvalidInputError, match="workers: expected an integer >= 1"):
        fit_tasks(tasks, events, BOX, workers=0)


def test_processes_are_as_many_as_pay_for_their_start(monkeypatch):
    tasks = [Task(k, 0) for k in range(1, 16)]
    monkeypatch.setattr(ensemble, "available_cores", lambda: 64)
    assert ensemble.worthwhile_workers(tasks, 157_757) == 8
    assert ensemble.worthwhile_workers(tasks, 400) == 1
    assert ensemble.worthwhile_workers([], 157_757) == 1
    monkeypatch.setattr(ensemble, "available_cores", lambda: 2)
    assert ensemble.worthwhile_workers(tasks, 157_757) == 2


def test_few_events_start_no_process(events, monkeypatch):
    monkeypatch.setattr(ensemble, "ProcessPoolExecutor", None)
    assert len(fit_tasks([Task(1, 0), Task(1, 1)], events, BOX, workers=None)) == 2
    assert len(fit_tasks([Task(1, 0)], events, BOX, workers=8)) == 1


def test_a_task_without_bootstrap_is_the_plain_fit(events):
    plain = TruncatedGaussianMixture(2, **BOX, random_state=5).fit(events)
    assert fit_task(Task(2, 5), events, BOX).log_likelihood == plain.log_likelihood_


def family():
    return law().__class__(
        law().weights, law().means, law().covariances, law().lower, law().upper, ["a", "b"],
        members=[law(), law(0.5), law(1.0)],
    )  # fmt: skip


def test_the_average_is_the_mean_of_the_densities():
    model = family()
    x = model.sample(50, 1)
    densities = np.exp([member.log_density(x) for member in model.members])
    assert np.exp(model.average.log_density(x)) == pytest.approx(densities.mean(axis=0))
    log_average, ratios = model.member_densities(x)
    assert np.exp(log_average) == pytest.approx(densities.mean(axis=0))
    assert ratios == pytest.approx((densities / densities.mean(axis=0)).T)
    assert law().average.members == ()


def test_members_are_kept_by_files_and_checked():
    model = family()
    again = TrafficModel.from_json(model.to_json())
    assert again == model
    assert again.members == model.members
    other = TrafficModel([1.0], [[0.0]], [[[1.0]]], [1.0], [9.0], ["a"])
    with pytest.raises(InvalidInputError, match=r"members\[0\]: expected the lower"):
        TrafficModel([1.0], [[0.0]], [[[1.0]]], [0.0], [9.0], ["a"], members=[other])


def test_a_model_is_its_own_first_member(events):
    fits = fit_tasks(member_tasks(2, (1,), 0), events, BOX)
    model = with_members(law(), fits)
    assert len(model.members) == 3
    assert np.array_equal(model.members[0].means, law().means)
    assert [m.provenance["n_components"] for m in model.members] == [2, 1, 1]
    assert model.members[1].names == ("a", "b")
