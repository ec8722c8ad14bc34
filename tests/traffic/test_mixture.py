import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.base import clone
from sklearn.exceptions import ConvergenceWarning, NotFittedError
from sklearn.mixture import GaussianMixture
from sklearn.utils.estimator_checks import parametrize_with_checks

from crashrate import datasets
from crashrate.errors import InvalidInputError, NumericalError
from crashrate.traffic import fitting
from crashrate.traffic.mixture import TruncatedGaussianMixture
from crashrate.traffic.model import TrafficModel

INF = np.inf
RECORDED = Path(__file__).resolve().parents[2] / "../shared/data/spmd_lane_changes.parquet"
ALGORITHMS = ["quasi-newton", "lee-scott"]


@parametrize_with_checks([TruncatedGaussianMixture()])
@pytest.mark.filterwarnings("ignore::sklearn.exceptions.SkipTestWarning")
def test_scikit_learns_contract(estimator, check):
    check(estimator)


def truth():
    return TrafficModel(
        [0.4, 0.6],
        [[0.0, 0.0], [2.5, 1.0]],
        [[[1.0, 0.3], [0.3, 0.6]], [[0.5, -0.2], [-0.2, 0.8]]],
        [-0.2, 0.0],
        [INF, INF],
        ["a", "b"],
    )


def overlapping(seed, n, d, k):
    """Events of k clusters in d variables, some cut off."""
    rng = np.random.default_rng(seed)
    centres = 2.0 * rng.normal(size=(k, d))
    x = centres[rng.integers(k, size=n)] + rng.normal(size=(n, d)) @ rng.normal(size=(d, d))
    lower = np.quantile(x, 0.2, axis=0)
    return x[(x >= lower).all(axis=1)], lower


def test_lee_scott_is_plain_em_when_the_box_is_infinite():
    x, _ = overlapping(0, 800, 3, 3)
    rng = np.random.default_rng(1)
    start = {
        "weights_init": np.array([0.2, 0.3, 0.5]),
        "means_init": x[rng.choice(len(x), 3, replace=False)],
        "precisions_init": np.stack([np.linalg.inv(np.cov(x.T))] * 3),
    }
    common = {"tol": 0.0, "max_iter": 15, **start}
    ours = TruncatedGaussianMixture(3, algorithm="lee-scott", prior_strength=0.0, **common)
    theirs = GaussianMixture(3, reg_covar=0.0, **common)
    with pytest.warns(ConvergenceWarning):
        ours.fit(x)
    with pytest.warns(ConvergenceWarning):
        theirs.fit(x)
    assert ours.n_safeguarded_ == 0
    np.testing.assert_allclose(ours.weights_, theirs.weights_, rtol=1e-9)
    np.testing.assert_allclose(ours.means_, theirs.means_, rtol=1e-8)
    np.testing.assert_allclose(ours.covariances_, theirs.covariances_, rtol=1e-8)
    np.testing.assert_allclose(ours.score_samples(x), theirs.score_samples(x), rtol=1e-9)
    assert ours.bic(x) == pytest.approx(theirs.bic(x), rel=1e-12)
    assert ours.aic(x) == pytest.approx(theirs.aic(x), rel=1e-12)
    np.testing.assert_array_equal(ours.predict(x), theirs.predict(x))


@settings(max_examples=12, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10**6),
    d=st.integers(1, 3),
    k=st.integers(1, 4),
    algorithm=st.sampled_from(ALGORITHMS),
    prior=st.sampled_from([0.1, 1.0]),
)
def test_the_likelihood_never_falls(seed, d, k, algorithm, prior):
    x, lower = overlapping(seed, 400, d, k)
    model = TruncatedGaussianMixture(
        k,
        lower=lower,
        algorithm=algorithm,
        prior_strength=prior,
        max_iter=40,
        random_state=seed,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        model.fit(x)
    bounds = np.array(model.lower_bounds_)
    assert (np.diff(bounds) >= 0.0).all()
    assert bounds[-1] == model.lower_bound_
    assert len(bounds) == model.n_iter_ + 1


def test_em_that_stopped_early_says_so():
    x = np.random.default_rng(0).exponential(size=(2000, 1))
    slow = TruncatedGaussianMixture(lower=0.0, algorithm="lee-scott", max_iter=60, tol=1e-9)
    with pytest.warns(ConvergenceWarning, match="not converged in 60 steps"):
        slow.fit(x)
    assert not slow.converged_
    quick = TruncatedGaussianMixture(lower=0.0).fit(x)
    assert quick.converged_
    assert quick.lower_bound_ > slow.lower_bound_  # where data pile up at a side EM crawls


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_known_parameters_come_back_from_truncated_data(algorithm):
    law = truth()
    x = law.sample(20_000, 1)
    model = TruncatedGaussianMixture(
        2, lower=law.lower, upper=law.upper, algorithm=algorithm, max_iter=2000, random_state=0,
        tol=1e-7 if algorithm == "quasi-newton" else 1e-6,
    ).fit(x)  # fmt: skip
    assert model.converged_
    order = np.argsort(model.means_[:, 0])
    np.testing.assert_allclose(model.weights_[order], law.weights, atol=0.03)
    np.testing.assert_allclose(model.means_[order], law.means, atol=0.25)
    np.testing.assert_allclose(model.covariances_[order], law.covariances, atol=0.25)
    assert model.score(x) > law.log_density(x).mean()
    # Negative control: a mixture that knows of no box misses them.
    plain = GaussianMixture(2, random_state=0).fit(x)
    first = plain.means_[np.argmin(plain.means_[:, 0])]
    assert np.abs(first - law.means[0]).max() > 0.4


def test_quasi_newton_climbs_higher_than_many_em_steps():
    law = truth()
    x = law.sample(4000, 2)
    box = {"lower": law.lower, "upper": law.upper, "random_state": 0}
    quick = TruncatedGaussianMixture(2, **box).fit(x)
    slow = TruncatedGaussianMixture(2, algorithm="lee-scott", max_iter=60, tol=0.0, **box)
    with pytest.warns(ConvergenceWarning):
        slow.fit(x)
    assert quick.lower_bound_ >= slow.lower_bound_
    assert quick.n_iter_ < 200


def test_one_component_on_an_exponential_pile_does_not_run_away():
    x = np.random.default_rng(3).exponential(size=(3000, 2))
    model = TruncatedGaussianMixture(lower=0.0, random_state=0).fit(x)
    assert model.converged_
    assert np.isfinite(model.means_).all()
    # The optimum is (almost) the exponential law: -2 nats per event, less nothing.
    assert model.score(x) == pytest.approx(-x.sum(axis=1).mean(), abs=5e-3)


@pytest.mark.parametrize("d", [4, 5])
def test_more_than_three_variables(d):
    rng = np.random.default_rng(d)
    covariance = 0.5 * np.eye(d) + 0.5
    law = TrafficModel(
        [1.0], [np.zeros(d)], [covariance], [-0.5] * d, [INF] * d, [f"x{i}" for i in range(d)]
    )
    x = law.sample(3000, rng)
    model = TruncatedGaussianMixture(lower=-0.5, tol=1e-5).fit(x)
    np.testing.assert_allclose(model.means_[0], 0.0, atol=0.35)
    np.testing.assert_allclose(model.covariances_[0], covariance, atol=0.35)


def test_results_are_in_the_units_of_the_data():
    law = truth()
    x = law.sample(3000, 4)
    scale, shift = np.array([1e-3, 50.0]), np.array([7.0, -20.0])
    small = TruncatedGaussianMixture(2, lower=law.lower, random_state=0).fit(x)
    large = TruncatedGaussianMixture(2, lower=shift + scale * law.lower, random_state=0)
    large.fit(shift + scale * x)
    np.testing.assert_allclose(large.means_, shift + scale * small.means_, rtol=1e-4, atol=1e-4)
    assert large.lower_bound_ == pytest.approx(small.lower_bound_, abs=1e-6)
    assert large.score(shift + scale * x) == pytest.approx(
        small.score(x) - np.log(scale).sum(), abs=1e-5
    )
    assert large.bic_ == pytest.approx(large.bic(shift + scale * x), rel=1e-9)


def test_the_traffic_model_is_the_estimator():
    law = truth()
    x = law.sample(2000, 5)
    model = TruncatedGaussianMixture(2, lower=law.lower, random_state=1).fit(x)
    traffic = model.traffic_model(names=["speed", "gap"])
    assert traffic.names == ("speed", "gap")
    assert traffic.lower.tolist() == law.lower.tolist()
    assert traffic.provenance["n_events"] == 2000
    assert traffic.provenance["bic"] == pytest.approx(model.bic(x))
    assert TrafficModel.from_json(traffic.to_json()) == traffic
    np.testing.assert_allclose(model.score_samples(x), traffic.log_density(x))
    np.testing.assert_allclose(model.predict_proba(x).sum(axis=1), 1.0)
    assert model.score_samples([[-9.0, 1.0]]).tolist() == [-INF]
    draws, labels = model.sample(500)
    assert draws.shape == (500, 2)
    assert traffic.contains(draws).all()
    assert (np.bincount(labels, minlength=2) > 0).all()
    again = clone(model).fit(x)
    np.testing.assert_array_equal(again.means_, model.means_)
    np.testing.assert_array_equal(model.fit_predict(x), model.predict(x))


@pytest.mark.parametrize("weighted", [False, True])
def test_by_way_of_a_part_many_events_end_where_they_would(monkeypatch, weighted):
    law = truth()
    x = law.sample(4000, 6)
    weights = np.random.default_rng(0).exponential(size=4000) if weighted else None
    whole = TruncatedGaussianMixture(2, lower=law.lower, random_state=0).fit_weighted(x, weights)
    monkeypatch.setattr(fitting, "_N_PART", 1000)
    by_part = TruncatedGaussianMixture(2, lower=law.lower, random_state=0)
    by_part.fit_weighted(x, weights)
    assert by_part.n_iter_ < whole.n_iter_
    assert by_part.converged_
    assert by_part.lower_bound_ == pytest.approx(whole.lower_bound_, abs=1e-6)


def test_a_part_that_holds_no_mixture_is_passed_over(monkeypatch):
    def fails(events, n):
        raise NumericalError(f"{n} of {events.n}")

    x = truth().sample(400, 7)
    monkeypatch.setattr(fitting, "_N_PART", 100)
    monkeypatch.setattr(fitting.Events, "part", fails)
    assert TruncatedGaussianMixture(2, random_state=0).fit(x).converged_


@pytest.mark.skipif(not RECORDED.exists(), reason="recorded lane changes not at ../shared/data")
def test_recorded_lane_changes():
    from pyarrow import parquet

    published = datasets.spmd_mixture()
    table = parquet.read_table(RECORDED, columns=list(published.names))
    x = np.column_stack([column.to_numpy() for column in table.columns])
    n_parameters = 8 + 9 * 3 + 9 * 6
    bic = -2 * published.log_density(x).sum() + n_parameters * np.log(len(x))
    assert bic == pytest.approx(-730_907, abs=1)
    model = TruncatedGaussianMixture(
        6, lower=published.lower, upper=published.upper, random_state=0
    ).fit(x[::8])
    assert model.converged_
    # Six components found here beat the study's nine.
    assert model.score(x) > published.log_density(x).mean()


def test_a_climb_that_is_stuck_does_not_call_itself_converged():
    # Without a prior the best law on a falling slope lies at infinity.
    x = np.random.default_rng(0).exponential(size=(2000, 3)) ** 1.5
    model = TruncatedGaussianMixture(lower=0.0, prior_strength=0.0)
    with pytest.warns(ConvergenceWarning, match="still promises a gain"):
        model.fit(x)
    assert not model.converged_
    assert model.promise_ > 0.0
    calm = TruncatedGaussianMixture(lower=0.0).fit(x)
    assert calm.converged_
    assert calm.promise_ < 1e-6


@pytest.mark.parametrize(
    ("columns", "names"), [(["speed", "gap"], ("speed", "gap")), (["a b", "c"], ("x0", "x1"))]
)
def test_variables_are_named_as_the_columns_where_they_can_be(columns, names):
    model = TruncatedGaussianMixture().fit(np.random.default_rng(0).random((20, 2)))
    model.feature_names_in_ = np.array(columns, dtype=object)  # as from a data frame
    assert model.traffic_model().names == names


def test_more_starts_are_never_worse():
    x, lower = overlapping(3, 600, 2, 4)
    one = TruncatedGaussianMixture(4, lower=lower, random_state=2).fit(x)
    many = TruncatedGaussianMixture(4, lower=lower, random_state=2, n_init=3).fit(x)
    assert many.lower_bound_ >= one.lower_bound_


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"n_components": 0}, "n_components: expected an integer >= 1, got 0"),
        ({"n_components": 50}, "n_components = 50 events, got n_samples = 20"),
        ({"max_iter": 0}, "max_iter"),
        ({"n_init": 0}, "n_init"),
        ({"tol": -1.0}, "tol: expected a number >= 0"),
        ({"prior_strength": INF}, "prior_strength"),
        ({"algorithm": "magic"}, "one of quasi-newton, lee-scott, got 'magic'"),
        ({"lower": [0.0]}, "lower: expected a number or one for each of 2 columns"),
        ({"lower": [0.0, 3.0], "upper": [None, 3.0]}, "expected lower < upper"),
        ({"lower": [0.5, None]}, "X: expected events inside the box, got .* column 0"),
        ({"means_init": [[0.0]]}, r"means_init: expected finite numbers of shape \(1, 2\)"),
    ],
)
def test_bad_parameters_are_named(parameters, words):
    x = np.random.default_rng(0).random((20, 2))
    with pytest.raises(InvalidInputError, match=words):
        TruncatedGaussianMixture(**parameters).fit(x)


def test_order_of_calls():
    with pytest.raises(NotFittedError):
        TruncatedGaussianMixture().traffic_model()
    with pytest.raises(NotFittedError):
        TruncatedGaussianMixture().sample()
    fitted = TruncatedGaussianMixture().fit(np.random.default_rng(0).random((20, 2)))
    with pytest.raises(InvalidInputError, match="n_samples"):
        fitted.sample(0)


def test_a_fit_with_no_mass_in_the_box_is_a_numerical_failure(monkeypatch):
    """So that other starts go on: it is not the user's input that is wrong."""
    monkeypatch.setattr("crashrate.traffic.model._MIN_LOG_MASS", 0.0)
    x = np.random.default_rng(0).exponential(size=(50, 1))
    with pytest.raises(NumericalError, match="component 0: expected some of its mass in the box"):
        TruncatedGaussianMixture(1, lower=[0.0], random_state=0).fit(x)
