"""Probability that a situation crashes, given the outcomes so far: a probit Gaussian process.

Inference is parallel expectation propagation (Rasmussen & Williams 2006, §3.6), with sites that
can be taken over from the last fit. The surrogate only steers where to simulate: the estimate
corrects it with simulated outcomes, so that an error here costs runs, not honesty; but for what it
and the risk order hold for certain together, which is hardly simulated at all.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_solve, solve_triangular
from scipy.special import erfcx, log_ndtr, ndtr

from crashrate.variables import BoolArray, FloatArray

IntArray = npt.NDArray[np.intp]

MAX_SWEEPS = 25
SWEEP_TOLERANCE = 0.02
CONVERGED = 0.1  # largest relative change of a site's precision in the last sweep
DAMPING = 0.7  # parallel updates oscillate undamped
MIN_VARIANCE = 1e-10


@dataclass(frozen=True, slots=True)
class Prior:
    """Gaussian-process prior of the latent danger: a plane plus a smooth bump.

    k(u, v) = s² (linear (1 + u·v) + bump exp(-|u - v|² / 2 length²)),
    mean(u) = s slope Σu / √m + constant √k(u, u).

    Where it is additive the bump is a sum of one for each coordinate, the mean over i of
    exp(-(u_i - v_i)² / 2 length²): what one coordinate adds does not depend on the others, and few
    labels tell much in many coordinates (Duvenaud, Nickisch & Rasmussen 2011).

    Parameters
    ----------
    bump, length : float
        Weight and length of the squared-exponential part, `u` standardised.
    variance : float
        s²: large values make sharp labels.
    linear, slope : float
        Of the plane; a positive slope says that danger grows with every coordinate.
    constant : float
        Of the mean, in prior standard deviations at each place. Negative, it keeps what no label
        tells of below the edge, equally surely near by and far away, where the plane may be
        anything.
    additive : bool
    """

    bump: float
    length: float
    variance: float
    linear: float
    slope: float
    constant: float
    additive: bool = False

    def mean(self, u: FloatArray) -> FloatArray:
        """Prior mean at `u` (n, m), shape (n,)."""
        plane = self.slope * u.sum(axis=1) / math.sqrt(u.shape[1])
        below = self.constant * np.sqrt(self.variances(u))
        return np.asarray(math.sqrt(self.variance) * plane + below)

    def covariance(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Prior covariance between `u` (n, m) and `v` (k, m), shape (n, k)."""
        smooth = self._each(u, v) if self.additive else self._joint(u, v)
        kernel: FloatArray = self.linear * (1 + u @ v.T) + self.bump * smooth
        return self.variance * kernel

    def _joint(self, u: FloatArray, v: FloatArray) -> FloatArray:
        squares = (u**2).sum(axis=1)[:, None] + (v**2).sum(axis=1) - 2 * (u @ v.T)
        # rounding may leave -1e-16 in a squared distance
        return np.asarray(np.exp(np.maximum(squares, 0.0) / (-2 * self.length**2)))

    def _each(self, u: FloatArray, v: FloatArray) -> FloatArray:
        a, b = u / (math.sqrt(2) * self.length), v / (math.sqrt(2) * self.length)
        total, part = np.zeros((len(u), len(v))), np.empty((len(u), len(v)))
        for i in range(u.shape[1]):  # in place: thrice as fast
            np.subtract(a[:, i, None], b[:, i], out=part)
            np.negative(np.multiply(part, part, out=part), out=part)
            total += np.exp(part, out=part)
        return np.asarray(total / u.shape[1])

    def variances(self, u: FloatArray) -> FloatArray:
        """Prior variance at `u` (n, m), shape (n,)."""
        kernel: FloatArray = self.linear * (1 + (u**2).sum(axis=1)) + self.bump
        return self.variance * kernel


@dataclass(frozen=True, slots=True)
class Sites:
    """Gaussian approximations of the n likelihood terms: precisions and precision × mean.

    NaN where a term was never approximated.
    """

    tau: FloatArray
    nu: FloatArray

    @classmethod
    def unknown(cls, n: int) -> "Sites":
        """Of `n` terms that were never approximated."""
        return cls(np.full(n, np.nan), np.full(n, np.nan))

    def grown(self, n: int) -> "Sites":
        """With unknown ones added, `n` in all."""
        more = Sites.unknown(n - len(self.tau))
        return Sites(np.concatenate([self.tau, more.tau]), np.concatenate([self.nu, more.nu]))

    def of(self, rows: IntArray) -> "Sites":
        """Those of `rows`."""
        return Sites(self.tau[rows], self.nu[rows])

    def put(self, rows: IntArray, sites: "Sites") -> "Sites":
        """With those of `rows` replaced."""
        tau, nu = self.tau.copy(), self.nu.copy()
        tau[rows], nu[rows] = sites.tau, sites.nu
        return Sites(tau, nu)


@dataclass(frozen=True, slots=True)
class Prediction:
    """What a surrogate holds about n points.

    Parameters
    ----------
    probability : ndarray, shape (n,)
        P(crash | labels).
    danger : ndarray, shape (n,)
        Posterior mean of the latent danger over s: about the distance from the crash set's edge in
        standardised coordinates, positive inside.
    """

    probability: FloatArray
    danger: FloatArray


@dataclass(frozen=True, slots=True)
class Surrogate:
    """A fitted classifier.

    Parameters
    ----------
    prior : Prior
    u : ndarray, shape (n, m)
        Labelled points.
    sites : Sites
    log_score : float
        Sum of the log leave-one-out probabilities of the labels: chooses among priors.
    converged : bool
        Whether the sites had settled. Labels that contradict each other under a sharp prior make
        them oscillate: score and probabilities are then of little worth.
    root : ndarray, shape (n, n)
        Inverse Cholesky factor of I + S K S times S, in single precision (it enters a variance).
    coefficients : ndarray, shape (n,)
        Of the posterior mean.
    """

    prior: Prior
    u: FloatArray
    sites: Sites
    log_score: float
    converged: bool
    root: np.ndarray
    coefficients: FloatArray

    def predict(self, u: FloatArray, block: int = 4096) -> Prediction:
        """What is held about the points `u` (n, m)."""
        mean, variance = self._latent(u, block)
        probability = ndtr(mean / np.sqrt(1 + variance))
        return Prediction(probability, mean / math.sqrt(self.prior.variance))

    def left_out(self, u: FloatArray, crash: BoolArray) -> tuple[FloatArray, Sites]:
        """Log probabilities (n,) of labels that the fit has left out, and sites for them.

        One step of expectation propagation: they are sharp where the fit does not explain them.
        """
        z, sites = _matched(*self._latent(u), np.where(crash, 1.0, -1.0))
        return log_ndtr(z), sites

    def _latent(self, u: FloatArray, block: int = 4096) -> tuple[FloatArray, FloatArray]:
        parts = [self._marginals(u[i : i + block]) for i in range(0, len(u), block)]
        mean, variance = np.concatenate([np.empty((2, 0)), *parts], axis=1)
        return mean, variance

    def _marginals(self, u: FloatArray) -> FloatArray:
        """Posterior mean and variance of the latent danger at `u` (n, m), shape (2, n)."""
        k = self.prior.covariance(u, self.u)
        explained = k.astype(np.float32) @ self.root.T
        variance = self.prior.variances(u) - np.einsum("ij,ij->i", explained, explained)
        mean = self.prior.mean(u) + k @ self.coefficients
        return np.stack([mean, np.maximum(variance, MIN_VARIANCE)])


@dataclass(frozen=True, slots=True)
class _Posterior:
    """Marginals of the latent values at the labelled points, and the factor they came from."""

    chol: FloatArray
    mean: FloatArray
    variance: FloatArray


def fit_surrogate(
    u: FloatArray, crash: BoolArray, prior: Prior, warm: Sites | None = None
) -> Surrogate:
    """Fit the classifier to labelled points.

    Parameters
    ----------
    u : ndarray, shape (n, m)
        Standardised risk coordinates.
    crash : ndarray of bool, shape (n,)
    prior : Prior
    warm : Sites, optional
        Of earlier fits, one for each label; NaN where there was none.
    """
    signs = np.where(crash, 1.0, -1.0)
    covariance, mean = prior.covariance(u, u), prior.mean(u)
    sites = _start(signs, mean, prior, warm)
    for _ in range(MAX_SWEEPS):
        z, new = _sweep(_posterior(covariance, mean, sites), sites, signs)
        moved = np.abs(new.tau - sites.tau) / (sites.tau + 1e-3 / prior.variance)
        sites = Sites(*(_damped(o, n) for o, n in ((sites.tau, new.tau), (sites.nu, new.nu))))
        if moved.max() < SWEEP_TOLERANCE:
            break
    score, settled = float(log_ndtr(z).sum()), bool(moved.max() < CONVERGED)
    return _predictor(
        u, prior, sites, covariance=covariance, mean=mean, score=score, converged=settled
    )


def _damped(old: FloatArray, new: FloatArray) -> FloatArray:
    return (1 - DAMPING) * old + DAMPING * new


def _start(signs: FloatArray, mean: FloatArray, prior: Prior, warm: Sites | None) -> Sites:
    tau = np.full(len(signs), 0.1 / prior.variance)
    nu = tau * mean + 1e-3 * signs
    if warm is None:
        return Sites(tau, nu)
    known = ~np.isnan(warm.tau)
    return Sites(np.where(known, warm.tau, tau), np.where(known, warm.nu, nu))


def _factor(covariance: FloatArray, tau: FloatArray) -> FloatArray:
    s = np.sqrt(tau)
    scaled: FloatArray = np.eye(len(tau)) + s[:, None] * covariance * s
    return np.asarray(np.linalg.cholesky(scaled), dtype=np.float64)


def _posterior(covariance: FloatArray, mean: FloatArray, sites: Sites) -> _Posterior:
    chol = _factor(covariance, sites.tau)
    scaled = np.sqrt(sites.tau)[:, None] * covariance
    v = solve_triangular(chol, scaled, lower=True, check_finite=False)
    variance = np.maximum(np.diag(covariance) - (v * v).sum(axis=0), MIN_VARIANCE)
    pull = sites.nu - sites.tau * mean
    return _Posterior(chol, mean + covariance @ pull - v.T @ (v @ pull), variance)


def _sweep(post: _Posterior, sites: Sites, signs: FloatArray) -> tuple[FloatArray, Sites]:
    # cavity: the marginal without the point's own site
    precision = np.maximum(1 / post.variance - sites.tau, MIN_VARIANCE)
    variance = 1 / precision
    return _matched((post.mean / post.variance - sites.nu) * variance, variance, signs)


def _matched(mean: FloatArray, variance: FloatArray, signs: FloatArray) -> tuple[FloatArray, Sites]:
    """The sites that give cavity (n,) × probit likelihood its moments, and their arguments.

    Rasmussen & Williams 2006, eq. 3.58.
    """
    scale = np.sqrt(1 + variance)
    z = signs * mean / scale
    ratio = math.sqrt(2 / math.pi) / erfcx(-z / math.sqrt(2))
    tilted_mean = mean + signs * variance * ratio / scale
    shrink = variance**2 * np.clip(ratio * (z + ratio), 0.0, 1.0) / (1 + variance)
    tilted_variance = np.maximum(variance - shrink, MIN_VARIANCE)
    tau = np.maximum(1 / tilted_variance - 1 / variance, 1e-12)
    return z, Sites(tau, tilted_mean / tilted_variance - mean / variance)


def _predictor(
    u: FloatArray,
    prior: Prior,
    sites: Sites,
    *,
    covariance: FloatArray,
    mean: FloatArray,
    score: float,
    converged: bool,
) -> Surrogate:
    s = np.sqrt(sites.tau)
    chol = _factor(covariance, sites.tau)
    pull = sites.nu - sites.tau * mean
    coefficients = pull - s * cho_solve((chol, True), s * (covariance @ pull), check_finite=False)
    root = solve_triangular(chol, np.diag(s), lower=True, check_finite=False)
    return Surrogate(prior, u, sites, score, converged, root.astype(np.float32), coefficients)
