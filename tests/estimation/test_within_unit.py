"""Estimates that left [0, 1] come back, and their intervals with them."""

import numpy as np
import pytest

from crashrate.estimation.within_unit import within_unit


def test_an_estimate_within_stays_as_it_is():
    got = within_unit(0.3, 0.1, 0.25, 0.45)
    assert (got.estimate, got.lower, got.upper) == pytest.approx((0.3, 0.15, 0.55))


@pytest.mark.parametrize(
    ("center", "half_width", "expected"),
    [
        (1.002, 0.01, (1.0, 0.99, 1.0)),
        (1.002, 0.0001, (1.0, 0.998, 1.0)),  # off by 0.002 at the least
        (-0.002, 0.0001, (0.0, 0.0, 0.002)),
        (0.999, 0.01, (0.999, 0.989, 1.0)),
    ],
)
def test_what_is_outside_is_off_by_its_distance(center, half_width, expected):
    got = within_unit(center, half_width, center, center)
    assert (got.estimate, got.lower, got.upper) == pytest.approx(expected)


def test_ends_hold_the_estimate_whatever_comes():
    rng = np.random.default_rng(1)
    for center, least, most in rng.normal(0.5, 1, (200, 3)):
        half_width = abs(rng.normal(0, 0.1))
        got = within_unit(center, half_width, center - abs(least), center + abs(most))
        assert 0 <= got.lower <= got.estimate <= got.upper <= 1
