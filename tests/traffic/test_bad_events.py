"""Events that no mixture should be fitted to, and odd ones that it can be."""

import warnings

import numpy as np
import pytest
from sklearn.exceptions import ConvergenceWarning

from crashrate.errors import CrashrateError, InvalidInputError
from crashrate.traffic.mixture import TruncatedGaussianMixture


def drawn(n=400, d=2):
    return np.random.default_rng(0).normal(size=(n, d))


def with_cell(value):
    x = drawn()
    x[7, 1] = value
    return x


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_cells_that_are_no_numbers(value):
    with pytest.raises(ValueError, match=r"contains NaN|contains infinity"):
        TruncatedGaussianMixture().fit(with_cell(value))


@pytest.mark.parametrize(
    ("x", "parameters", "words"),
    [
        (drawn(), {"lower": 5.0}, r"X: expected events inside the box.*widen the box or drop"),
        (drawn(), {"upper": [9.0, 0.0]}, r"at row \d+, column 1, where \[-inf, 0.0\] is allowed"),
        (drawn(), {"scales": ["log", "linear"]}, "expected positive numbers of x0"),
        (drawn(5), {"n_components": 6}, "at least n_components = 6 events, got n_samples = 5"),
    ],
)
def test_what_is_wrong_is_said_with_what_to_do(x, parameters, words):
    with pytest.raises(InvalidInputError, match=words):
        TruncatedGaussianMixture(**parameters).fit(x)


def test_a_single_row():
    with pytest.raises(ValueError, match="minimum of 2 is required"):
        TruncatedGaussianMixture().fit(drawn(1))


def constant():
    x = drawn()
    x[:, 1] = 3.7e9
    return x


@pytest.mark.parametrize("make", [constant, lambda: np.ones((50, 2)), lambda: drawn()[:, [0, 0]]])
@pytest.mark.parametrize("k", [1, 3])
def test_columns_without_a_spread_of_their_own_are_fitted_or_refused(make, k):
    x = make()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # is said, and is enough
        try:
            model = TruncatedGaussianMixture(k, random_state=0).fit(x)
        except CrashrateError as error:
            assert len(str(error)) > 60  # noqa: PT017 - either is right
        else:
            assert np.isfinite(model.score_samples(x)).all()


def atom(rng, n, d):
    """A fifth of the rows exactly on a side."""
    x = rng.exponential(size=(n, d))
    x[rng.random(n) < 0.2, 0] = 0.0
    return x


def corner(rng, n, d):
    return np.where(rng.random((n, d)) < 0.2, 0.0, np.abs(rng.normal(size=(n, d))))


def pile(rng, n, d):
    return rng.exponential(size=(n, d)) ** 3


@pytest.mark.parametrize("make", [atom, corner, pile])
@pytest.mark.parametrize("n", [60, 5000])
def test_one_component_on_a_pile_at_a_side_converges(make, n):
    x = make(np.random.default_rng(0), n, 3)
    model = TruncatedGaussianMixture(lower=0.0, random_state=0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model.fit(x)
    assert model.converged_
    assert np.isfinite(model.score(x))
