"""The infinitesimal jackknife against refits, and its error against fits to new events."""

import numpy as np
import pytest

from crashrate.traffic.influence import FittedMixture, influence
from crashrate.traffic.mixture import TruncatedGaussianMixture

N = 400
LEVEL = 3.2
BOX = dict(lower=[0.0, 0.0], upper=[np.inf, np.inf])


def events(seed, n=N):
    rng = np.random.default_rng(seed)
    x = np.abs(rng.normal(size=(n, 2))) * [1.0, 0.5]
    x[: 3 * n // 8] += [1.5, 0.6]
    return x


def beyond(model):
    return float(model.box_probability([LEVEL, -np.inf], [np.inf, np.inf]))


def fit(x, weights=None, **start):
    mixture = TruncatedGaussianMixture(2, **BOX, tol=1e-12, max_iter=3000, random_state=0, **start)
    return mixture.fit_weighted(x, weights)


def jackknife(x, fitted):
    z = fitted.model_.sample(400_000, 1)
    inside = z[:, 0] > LEVEL
    weights = np.full(int(inside.sum()), beyond(fitted.model_) / inside.sum())
    return influence(
        FittedMixture.of(fitted.model_, x, fitted.prior_strength_), x, z[inside], weights
    )


@pytest.fixture(scope="module")
def fitted():
    return fit(events(0))


@pytest.fixture(scope="module")
def found(fitted):
    return jackknife(events(0), fitted)


@pytest.mark.parametrize("rank", [0, 1, 2, 50, 399])
def test_influence_is_that_of_a_refit(fitted, found, rank):
    i, x = found.most(N)[rank], events(0)
    start = dict(
        weights_init=fitted.weights_,
        means_init=fitted.means_,
        precisions_init=np.linalg.inv(fitted.covariances_),
    )
    moved = []
    for step in (0.05, -0.05):
        weights = np.ones(N)
        weights[i] += step
        moved.append(beyond(fit(x, weights, **start).model_))
    slope = (moved[0] - moved[1]) / 0.1
    scale = np.abs(found.per_event).max()
    assert found.per_event[i] == pytest.approx(slope, rel=0.03, abs=0.003 * scale)


def test_nothing_is_flat_here_and_the_influences_cancel(found):
    assert found.n_flat == 0
    # at the maximum the scores of all events add up to the weak prior's pull
    assert abs(found.per_event.sum()) < 0.2 * np.abs(found.per_event).sum()


def test_standard_error_is_the_spread_over_new_events():
    errors, numbers = [], []
    for seed in range(30):
        x = events(seed, 1500)
        fitted = fit(x)
        numbers.append(beyond(fitted.model_))
        if seed < 8:
            errors.append(jackknife(x, fitted).standard_error)
    assert np.mean(errors) == pytest.approx(np.std(numbers, ddof=1), rel=0.4)


def test_shares_of_variance_grow_to_one(found):
    shares = [found.variance_share(n) for n in (0, 1, 5, 50, N)]
    assert shares[0] == 0.0
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0)
