"""Risk coordinates that are refused before any run, and those that are not."""

import numpy as np
import pytest

from crashrate.errors import InvalidInputError
from crashrate.estimation.run import estimate
from crashrate.estimation.usable import require_usable
from crashrate.expressions import Expression

RNG = np.random.default_rng(0)
A, B = RNG.standard_normal((2, 500))


@pytest.mark.parametrize(
    ("u", "words"),
    [
        ([A, np.full(500, -2.0)], "'b': expected values that differ .* got 2 for all; leave it"),
        ([A, -A], "'a' and 'b': expected claims that can hold together"),
        ([A, -np.exp(A)], "one of the directions is wrong"),
        ([A, np.exp(40 * B)], "'b': expected values of comparable size"),
    ],
)
def test_unusable_coordinates_are_refused(u, words):
    with pytest.raises(InvalidInputError, match=words):
        require_usable(("a", "b"), np.column_stack(u))


@pytest.mark.parametrize(
    "u", [[A, B], [A, A], [A, 0.01 * B - A], [A, np.floor(B)], [A, np.minimum(-A, 0.5)], [A]]
)
def test_others_are_not(u):
    assert require_usable("ab"[: len(u)], np.column_stack(u)) is None


def test_they_cost_no_run(cases):
    def simulate(_):
        raise AssertionError("simulated")

    traffic, both = cases.standard_normal(2), ("increasing", "decreasing")
    risk = {
        name: (Expression("a", traffic.names), way) for name, way in zip("uv", both, strict=True)
    }
    with pytest.raises(InvalidInputError, match="'u' and 'v'"):
        estimate(simulate, traffic, risk=risk)
