"""The width of an interval in words."""

import math

import pytest

from crashrate.estimation.width import is_skewed, width_text


@pytest.mark.parametrize(
    ("estimate", "interval", "words"),
    [
        (2e-6, (1.8e-6, 2.2e-6), "± 10 %"),
        (1.0, (0.9996, 1.0004), "± 0.04 %"),
        (1.0, (1.0, 1.0), "± 0 %"),
        (1.0, (0.0, 2.0), "± 100 %"),
        (1.0, (0.29, 1.08), "-71 %, +8 %"),
        (1.0, (0.0, 3.1), ""),
        (math.nan, (0.0, 1.0), ""),
        (0.0, (0.0, 0.1), ""),
    ],
)
def test_width(estimate, interval, words):
    assert width_text(estimate, interval) == words


def test_a_small_difference_of_the_sides_is_no_skew():
    assert not is_skewed(1.0, (0.9, 1.14))
    assert is_skewed(1.0, (0.9, 1.16))
    assert is_skewed(1.0, (0.84, 1.1))
