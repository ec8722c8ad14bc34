import numpy as np
import pytest
from scipy.special import log_ndtr
from scipy.stats import kstest

from crashrate.traffic.one_dimension import interval_moments, log_interval_probability, quantile


@pytest.mark.parametrize("a", [-40.0, -3.0, 0.0, 0.5, 8.0, 37.0, 1e3])
def test_one_sided_probability_is_log_ndtr(a):
    assert log_interval_probability(a, np.inf) == pytest.approx(log_ndtr(-a), rel=1e-13)
    assert log_interval_probability(-np.inf, -a) == pytest.approx(log_ndtr(-a), rel=1e-13)


@pytest.mark.parametrize("a", [-20.0, -1.0, 0.0, 2.0, 30.0])
@pytest.mark.parametrize("width", [1e-9, 1e-6, 1e-3])
def test_narrow_interval_is_density_times_width(a, width):
    width = (a + width) - a  # as far as the two ends can tell
    middle = a + 0.5 * width
    # Second-order Taylor: the density's curvature at the middle.
    expected = -0.5 * middle**2 - 0.5 * np.log(2 * np.pi) + np.log(width)
    expected += np.log1p(width**2 * (middle**2 - 1) / 24)
    assert log_interval_probability(a, a + width) == pytest.approx(expected, rel=1e-10)


def test_intervals_that_tile_the_line_add_up():
    ends = np.array([-np.inf, -9.0, -2.0, -0.3, 0.0, 0.1, 4.0, 11.0, np.inf])
    total = np.exp(log_interval_probability(ends[:-1], ends[1:])).sum()
    assert total == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize("a", [0.0, 3.0, 50.0])
def test_moments_of_a_tail(a):
    moments = interval_moments(np.array([a]), np.array([np.inf]))
    hazard = np.exp(-0.5 * a**2 - 0.5 * np.log(2 * np.pi) - log_ndtr(-a))
    assert moments.mean[0] == pytest.approx(hazard, rel=1e-12)
    cancelling = 1.0 + a * hazard - hazard**2
    assert moments.second[0] == pytest.approx(cancelling, rel=1e-12, abs=1e-12 * hazard**2)


def test_moments_of_the_whole_line_and_of_a_narrow_interval():
    whole = interval_moments(np.array([-np.inf]), np.array([np.inf]))
    values = [whole.mean[0], whole.second[0], whole.third[0], whole.fourth[0]]
    assert values == pytest.approx([0.0, 1.0, 0.0, 3.0], abs=1e-12)
    narrow = interval_moments(np.array([5.0]), np.array([5.0 + 2.0**-20]))
    assert narrow.second[0] == pytest.approx(2.0**-40 / 12, rel=1e-6)  # uniform


@pytest.mark.parametrize(
    ("a", "b"), [(-1.0, 2.0), (5.0, np.inf), (-np.inf, -33.0), (33.0, 33.1), (60.0, np.inf)]
)
def test_quantiles_follow_the_law(a, b):
    u = np.random.default_rng(0).random(20_000)
    z = quantile(u, np.full(1, a), np.full(1, b))
    log_p = log_interval_probability(a, b)

    def cdf(x):
        return np.exp(log_interval_probability(a, np.maximum(x, a + 1e-300)) - log_p)

    assert ((z >= a) & (z <= b)).all()
    assert kstest(z, cdf).pvalue > 1e-3
    assert kstest(quantile(u**1.1, np.full(1, a), np.full(1, b)), cdf).pvalue < 1e-6
