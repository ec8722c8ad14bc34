import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import log_ndtr, ndtr
from scipy.stats import kstest

from crashrate.errors import InvalidInputError, NumericalError
from crashrate.traffic.one_dimension import log_interval_probability
from crashrate.traffic.truncated_normal import box_moments, log_box_probability, sample_truncated

INF = np.inf


def random_covariance(rng, d):
    a = rng.normal(size=(d, d + 1))
    return a @ a.T / d + 0.1 * np.eye(d)


def grid_moments(mean, covariance, lower, upper, n=60):
    """Mass, mean and covariance on a finite box by a plain tensor Gauss-Legendre rule."""
    x, w = np.polynomial.legendre.leggauss(n)
    half = 0.5 * (np.array(upper) - lower)
    axes = [lo + h * (1 + x) for lo, h in zip(lower, half, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, len(mean))
    weights = np.prod(np.stack(np.meshgrid(*[h * w for h in half], indexing="ij"), -1), -1).ravel()
    away = points - mean
    log_density = -0.5 * np.einsum("ni,ij,nj->n", away, np.linalg.inv(covariance), away)
    weights = weights * np.exp(
        log_density - 0.5 * np.linalg.slogdet(2 * np.pi * np.array(covariance))[1]
    )
    mass = weights.sum()
    centre = weights @ points / mass
    away = points - centre
    return np.log(mass), centre, (away * weights[:, None]).T @ away / mass


@pytest.mark.parametrize("d", [1, 2, 3])
def test_finite_boxes_against_a_plain_grid(d):
    rng = np.random.default_rng(d)
    for _ in range(4):
        mean, covariance = rng.normal(size=d), random_covariance(rng, d)
        lower = mean + rng.uniform(-2, 1, d)
        upper = lower + rng.uniform(0.3, 2, d)
        got = box_moments(mean, covariance, lower, upper)
        log_p, centre, spread = grid_moments(mean, covariance, lower, upper)
        assert got.log_probability[0] == pytest.approx(log_p, rel=1e-9, abs=1e-9)
        np.testing.assert_allclose(got.mean[0], centre, rtol=1e-8, atol=1e-9)
        np.testing.assert_allclose(got.covariance[0], spread, rtol=1e-7, atol=1e-9)


def test_orthants_have_their_closed_form():
    r = np.array([[1, 0.3, -0.6], [0.3, 1, 0.2], [-0.6, 0.2, 1]])
    two = np.log(0.25 + np.arcsin(0.3) / (2 * np.pi))
    three = np.log(1 / 8 + np.arcsin([0.3, -0.6, 0.2]).sum() / (4 * np.pi))
    assert log_box_probability([0, 0], r[:2, :2], [0, 0], [INF, INF])[0] == pytest.approx(two)
    assert log_box_probability([0, 0, 0], r, [0, 0, 0], [INF] * 3)[0] == pytest.approx(
        three, rel=1e-10
    )
    # A free variable leaves the orthant of the others.
    free = log_box_probability([0, 0, 0], r, [0, 0, -INF], [INF] * 3)
    assert free[0] == pytest.approx(two, rel=1e-12)


def one_factor(rho, lower, upper):
    """Log probability of a box under unit variances and equal correlations, by one integral."""
    side, root = np.sqrt(1 - rho), np.sqrt(rho)

    def integrand(t):
        parts = log_interval_probability(
            (np.array(lower) - root * t) / side, (np.array(upper) - root * t) / side
        )
        return np.exp(parts.sum() - 0.5 * t * t - shift) / np.sqrt(2 * np.pi)

    shift, peak = 0.0, 0.0
    grid = np.linspace(-40, 40, 8001)
    logs = [np.log(integrand(t) + 1e-320) for t in grid]
    peak, shift = grid[int(np.argmax(logs))], float(np.max(logs))
    return shift + np.log(quad(integrand, peak - 12, peak + 12, points=[peak], limit=400)[0])


@pytest.mark.parametrize(
    ("lower", "upper"),
    [
        ([0.0] * 5, [INF] * 5),
        ([-1, 0.2, -INF, 1, -0.5], [2, INF, 0.3, 1.4, 0.5]),
        ([3.0, 4.0, 2.0, 3.5, 3.0], [INF] * 5),
    ],
)
@pytest.mark.parametrize(("d", "tolerance"), [(3, 1e-8), (5, 3e-4)])
def test_equal_correlations_against_one_integral(d, tolerance, lower, upper):
    covariance = np.full((d, d), 0.5) + 0.5 * np.eye(d)
    got = log_box_probability(np.zeros(d), covariance, lower[:d], upper[:d])
    assert got[0] == pytest.approx(one_factor(0.5, lower[:d], upper[:d]), abs=tolerance)


@pytest.mark.parametrize("where", [5.0, 20.0, 37.0, 1e3])
@pytest.mark.parametrize("d", [1, 2, 3])
def test_far_tails_keep_relative_accuracy(d, where):
    scale = np.arange(1.0, d + 1)
    lower = np.full(d, -INF)
    lower[0], lower[-1] = where, 3.0
    upper = np.full(d, INF)
    upper[0] = where + 2.0
    got = box_moments(np.zeros(d), np.diag(scale**2), lower, upper)
    exact = log_interval_probability(lower / scale, upper / scale).sum()
    assert got.log_probability[0] == pytest.approx(exact, rel=1e-13)
    assert (np.linalg.eigvalsh(got.covariance[0]) > 0).all()
    assert (got.mean[0] > lower).all()


def test_correlated_tail_down_to_1e_minus_260():
    rho, at = 0.5, 30.0
    got = log_box_probability([0, 0], [[1, rho], [rho, 1]], [at, at], [INF, INF])[0]
    side = np.sqrt(1 - rho**2)

    def scaled(t):  # density of x relative to that at `at`, times P(y > at | x)
        x = at + t
        return np.exp(-0.5 * (x * x - at * at) + log_ndtr((rho * x - at) / side) + 300)

    exact = np.log(quad(scaled, 0, 3, epsabs=0, epsrel=1e-12, limit=200)[0]) - 300
    assert got == pytest.approx(exact - 0.5 * at**2 - 0.5 * np.log(2 * np.pi), abs=1e-9)
    assert got < -600


@pytest.mark.parametrize("rho", [0.5, 0.99, 0.999, 0.9999, 0.99999])
def test_three_strongly_correlated_variables_on_an_orthant(rho):
    # Their steps lie at the end of the stretch, where nodes must crowd.
    covariance = np.full((3, 3), rho) + (1.0 - rho) * np.eye(3)
    got = log_box_probability(np.zeros(3), covariance, np.zeros(3), np.full(3, INF))[0]
    assert np.exp(got) == pytest.approx(0.125 + 0.75 * np.arcsin(rho) / np.pi, rel=1e-10)


@pytest.mark.parametrize("rho", [0.99, -0.99, 0.999, -0.999])
@pytest.mark.parametrize("box", [([0, 0], [INF, INF]), ([-1, 0], [1, 0.7]), ([3, -INF], [9, 2.9])])
def test_strong_correlation(rho, box):
    got = log_box_probability([0, 0], [[1, rho], [rho, 1]], *box)[0]
    (a, c), (b, e) = box
    side = np.sqrt(1 - rho**2)

    def slice_(x):
        inner = log_interval_probability((c - rho * x) / side, (e - rho * x) / side)
        return np.exp(-0.5 * x * x + inner) / np.sqrt(2 * np.pi)

    # quad refines near the steps of the inner probability only where it is told of them.
    steps = [v / rho for v in (c, e) if np.isfinite(v) and a < v / rho < min(b, a + 30)]
    value = quad(
        slice_, a, min(b, a + 30), points=steps or None, limit=2000, epsabs=0, epsrel=1e-11
    )[0]
    if value > 1e-250:
        assert got == pytest.approx(np.log(value), rel=1e-8)


def test_a_turned_box_whose_variables_are_nearly_one():
    # {closing speed >= 40 m/s} in (v, 1/R, 1/TTC) is a box after a turn that leaves 1/R and the
    # new coordinate correlated by -0.9998: the saddle point's tilt is large, its z is not.
    factor = np.array([[1, 0, 0], [-1.5353, 1, 0], [46.4176, -30.4523, 1]])
    lower, upper = np.array([0.60828, 0.32723, -3.35952]), np.array([0.95392, INF, INF])
    got = log_box_probability(np.zeros(3), factor @ factor.T, lower, upper)[0]
    x, w = np.polynomial.legendre.leggauss(200)
    z0 = lower[0] + 0.5 * (upper[0] - lower[0]) * (1 + x)
    start = lower[1] + 1.5353 * z0
    z1 = start[:, None] + 1.5 * (1 + x)  # three standard deviations beyond the side: all of it
    last = log_ndtr(-(lower[2] - 46.4176 * z0[:, None] + 30.4523 * z1))
    logs = last - 0.5 * z1**2 - 0.5 * z0[:, None] ** 2 - np.log(2 * np.pi)
    sums = np.exp(logs - logs.max()) * w * 1.5 * (w * 0.5 * (upper[0] - lower[0]))[:, None]
    assert got == pytest.approx(logs.max() + np.log(sums.sum()), abs=1e-8)


def test_batches_are_the_single_boxes():
    rng = np.random.default_rng(7)
    means = rng.normal(size=(6, 3))
    covariances = np.stack([random_covariance(rng, 3) for _ in range(6)])
    lower = np.where(rng.random((6, 3)) < 0.3, -INF, means - rng.random((6, 3)))
    upper = np.where(rng.random((6, 3)) < 0.3, INF, means + 3 * rng.random((6, 3)))
    batch = box_moments(means, covariances, lower, upper)
    for i in range(6):
        one = box_moments(means[i], covariances[i], lower[i], upper[i])
        assert batch.log_probability[i] == pytest.approx(one.log_probability[0], rel=1e-9)
        np.testing.assert_allclose(batch.covariance[i], one.covariance[0], rtol=1e-7, atol=1e-10)
    broadcast = log_box_probability(means[0], covariances[0], lower, upper)
    assert broadcast.shape == (6,)


def test_no_box_at_all_gives_the_normal_back():
    covariance = random_covariance(np.random.default_rng(3), 5)
    got = box_moments(np.arange(5.0), covariance, [-INF] * 5, [INF] * 5)
    assert got.log_probability[0] == 0.0
    np.testing.assert_allclose(got.mean[0], np.arange(5.0), atol=1e-14)
    np.testing.assert_allclose(got.covariance[0], covariance, rtol=1e-12)


@pytest.mark.parametrize(
    ("means", "covariances", "lower", "upper", "words"),
    [
        ([0, 0], np.eye(3), [0, 0], [1, 1], r"covariances \(B, d, d\).*got \(1, 2\), \(1, 3, 3\)"),
        ([0, 0], np.eye(2), [0, 1], [1, 1], "variable 1: expected lower < upper"),
        ([0, np.nan], np.eye(2), [0, 0], [1, 1], "expected finite numbers"),
    ],
)
def test_bad_input_is_named(means, covariances, lower, upper, words):
    with pytest.raises(InvalidInputError, match=words):
        log_box_probability(means, covariances, lower, upper)


def test_singular_covariance_is_refused():
    with pytest.raises(NumericalError, match="positive definite"):
        log_box_probability([0, 0], [[1, 1], [1, 1]], [0, 0], [1, 1])


CASES = {
    "body": ([0.0, 0.0, 0.0], [-1, -INF, 0], [2, 1, INF]),
    "tail": ([0.0, 0.0, 0.0], [4, 3, -INF], [INF, INF, 0]),
    "1e-28": ([-9.0, 2.0, -8.0], [0, 0, 0], [2, INF, INF]),
    "narrow": ([0.0, 0.0, 0.0], [2, -0.1, 1], [2.01, 0.1, 1.3]),
}


@pytest.mark.parametrize("case", CASES)
def test_draws_have_the_exact_margins_and_moments(case):
    mean, lower, upper = CASES[case]
    covariance = np.array([[1, 0.5, -0.3], [0.5, 1.5, 0.2], [-0.3, 0.2, 0.8]])
    n = 20_000
    x = sample_truncated(mean, covariance, lower, upper, n, np.random.default_rng(11))
    assert x.shape == (n, 3)
    assert ((x >= lower) & (x <= upper)).all()
    law = box_moments(mean, covariance, lower, upper)
    scores = (x.mean(axis=0) - law.mean[0]) / np.sqrt(np.diag(law.covariance[0]) / n)
    assert np.abs(scores).max() < 4.0
    size = np.sqrt(np.diag(law.covariance[0]))
    difference = (np.cov(x.T) - law.covariance[0]) / np.outer(size, size)
    assert np.abs(difference).max() < 0.06  # a correlation's error is below 1 / sqrt(n) = 0.007
    for j in range(3):
        cdf = margin_cdf(mean, covariance, (lower, upper), j)
        assert kstest(x[:, j], cdf).pvalue > 1e-3
        moved = x[:, j] + 0.05 * x[:, j].std()
        assert kstest(moved, cdf).pvalue < 1e-3  # negative control


def margin_cdf(mean, covariance, box, j):
    """Exact distribution function of margin j, interpolated between grid points."""
    lower, upper = box
    law = box_moments(mean, covariance, lower, upper)
    centre, width = law.mean[0, j], 9 * np.sqrt(law.covariance[0, j, j])
    start = max(lower[j], centre - width)
    grid = np.linspace(start, min(upper[j], centre + width), 400)[1:]
    uppers = np.tile(np.array(upper, float), (len(grid), 1))
    uppers[:, j] = grid
    log_p = log_box_probability(mean, covariance, lower, uppers) - law.log_probability[0]
    grid, p = np.append(start, grid), np.append(0.0, np.exp(log_p))
    return lambda values: np.interp(values, grid, p)


def test_draws_of_one_variable_and_none():
    rng = np.random.default_rng(0)
    x = sample_truncated([0.0], [[4.0]], [1.0], [INF], 4000, rng)
    assert kstest(x[:, 0], lambda v: 1 - ndtr(-v / 2) / ndtr(-0.5)).pvalue > 1e-3
    assert sample_truncated([0.0], [[4.0]], [1.0], [INF], 0, rng).shape == (0, 1)
    with pytest.raises(InvalidInputError, match="draws >= 0"):
        sample_truncated([0.0], [[4.0]], [1.0], [INF], -1, rng)
    with pytest.raises(InvalidInputError, match=r"lower < upper"):
        sample_truncated([0.0], [[4.0]], [1.0], [1.0], 1, rng)
    with pytest.raises(InvalidInputError, match=r"covariance \(d, d\)"):
        sample_truncated([0.0], [[4.0, 0.0]], [1.0], [2.0], 1, rng)


def test_six_correlated_variables_are_drawn_exactly():
    rng = np.random.default_rng(5)
    covariance = random_covariance(rng, 6)
    lower, upper = np.full(6, 0.5), np.full(6, INF)
    x = sample_truncated(np.zeros(6), covariance, lower, upper, 20_000, rng)
    law = box_moments(np.zeros(6), covariance, lower, upper)
    scores = (x.mean(axis=0) - law.mean[0]) / np.sqrt(np.diag(law.covariance[0]) / len(x))
    assert np.abs(scores).max() < 4.5
