"""The truncated Gaussian mixture as a scikit-learn estimator."""

import math
import warnings
from collections.abc import Sequence
from typing import Any, Self

import numpy as np
import numpy.typing as npt
from sklearn.base import BaseEstimator, DensityMixin
from sklearn.exceptions import ConvergenceWarning
from sklearn.utils import check_random_state
from sklearn.utils.validation import check_is_fitted, validate_data
from threadpoolctl import threadpool_limits

from crashrate.errors import InvalidInputError, NumericalError
from crashrate.traffic.fitting import Algorithm, Fit, Schedule, fit_mixture
from crashrate.traffic.model import TrafficModel, default_names
from crashrate.traffic.objective import Events, Prior
from crashrate.traffic.scales import Scales
from crashrate.traffic.standard import Standard, checked_sides
from crashrate.traffic.start import Start, k_means_start
from crashrate.variables import FloatArray

# A mean this many standard deviations of the data outside the box is a component running away.
_MAX_DRIFT = 200.0
_PRIOR_GROWTH, _MAX_GROWTHS = 10.0, 4
PRIOR_STRENGTH = 1.0
_RIDGE = 1e-6  # of a standardised variance: the prior's covariance is never singular


class TruncatedGaussianMixture(DensityMixin, BaseEstimator):  # type: ignore[misc] # untyped
    """Gaussian mixture truncated to a box (paper, eqs. 2-8).

    Events are normalised inside; every result is in the units of the data.

    Parameters
    ----------
    n_components : int
        Number of components.
    lower, upper : float or array_like (d,), optional
        Sides of the box; None for no side at all, infinite where one variable has none.
    scales : sequence of {"linear", "log"}, optional
        Of each variable, linear by default: "log" models a positive variable's logarithm. Densities
        and criteria stay in the units of the data, so that scales can be compared by them.
    algorithm : {"quasi-newton", "lee-scott"}
        "quasi-newton": a few EM steps, then L-BFGS on the natural parameters; converges. Where
        events are many (90,000), first on a part of them.
        "lee-scott": the paper's EM, its steps safeguarded; slow where data pile up at a side.
    tol : float
        Converged when three steps in a row gain less than this in log likelihood per event, and
        the slope promises no more.
    max_iter : int
        Most steps of one fit.
    n_init : int
        Starts, of which the one with the best end is kept.
    prior_strength : float
        Pseudo-events that each component has seen of the data's own mean and covariance. They
        keep a component that models a slope at a side of the box from running away to infinity;
        0 for plain maximum likelihood.
    weights_init, means_init, precisions_init : array_like, optional
        The start, (K,), (K, d) and (K, d, d), as `weights_`, `means_` and inverse `covariances_`;
        by default k-means++.
    random_state : int, RandomState or None
        Seed of the starts and of :meth:`sample`.

    Attributes
    ----------
    weights_ : ndarray (K,)
        Weights of the truncated components.
    means_, covariances_ : ndarray (K, d), (K, d, d)
        Of the untruncated components; of logarithms where the scale is log.
    converged_ : bool
    n_iter_ : int
        Steps of the best fit.
    lower_bound_ : float
        Its log likelihood per event with the prior, in normalised units.
    lower_bounds_ : list of float
        The same at the start and after every step; never falling.
    promise_ : float
        Gain per event that the slope still promises one more step: 0 at the very top.
    n_safeguarded_ : int
        Component steps of EM that were shortened or replaced so that the likelihood not fall.
    prior_strength_ : float
        The prior used: `prior_strength`, or more where a component ran away with it.
    log_likelihood_ : float
        Log likelihood of the events, in the units of the data.
    bic_ : float
        Bayesian information criterion of the fitted events.
    model_ : TrafficModel
        The fitted law, with variables named x0, x1, ... or as the data frame's columns.
    n_features_in_ : int

    References
    ----------
    G. Lee and C. Scott, "EM algorithms for multivariate Gaussian mixture models with truncated
    and censored data", Computational Statistics & Data Analysis 56 (2012) 2816-2829.
    """

    def __init__(
        self,
        n_components: int = 1,
        *,
        lower: npt.ArrayLike | None = None,
        upper: npt.ArrayLike | None = None,
        scales: Sequence[str] | None = None,
        algorithm: str = "quasi-newton",
        tol: float = 1e-7,
        max_iter: int = 1000,
        n_init: int = 1,
        prior_strength: float = PRIOR_STRENGTH,
        weights_init: npt.ArrayLike | None = None,
        means_init: npt.ArrayLike | None = None,
        precisions_init: npt.ArrayLike | None = None,
        random_state: Any = None,
    ) -> None:
        self.n_components = n_components
        self.lower = lower
        self.upper = upper
        self.scales = scales
        self.algorithm = algorithm
        self.tol = tol
        self.max_iter = max_iter
        self.n_init = n_init
        self.prior_strength = prior_strength
        self.weights_init = weights_init
        self.means_init = means_init
        self.precisions_init = precisions_init
        self.random_state = random_state

    def fit(self, X: npt.ArrayLike, y: object = None) -> Self:
        """Fit the mixture to events X (n, d).

        Raises
        ------
        InvalidInputError
            If a parameter is out of range, or an event lies outside the box.
        NumericalError
            If the components collapse or run away whatever the prior.

        Warns
        -----
        ConvergenceWarning
            If `max_iter` steps were not enough.
        """
        del y
        return self.fit_weighted(X, None)

    def fit_weighted(self, X: npt.ArrayLike, weights: npt.ArrayLike | None) -> Self:
        """Fit the mixture to events X (n, d) that count `weights` (n,) times each.

        Everything as of :meth:`fit`, with sums over events weighted; starts and normalisation
        take every event once. None counts every event once.

        Raises
        ------
        InvalidInputError
            As of :meth:`fit`, or if the weights are not n numbers >= 0 with a positive sum.
        NumericalError
            As of :meth:`fit`.
        """
        schedule = self._schedule()
        rows = validate_data(self, X, dtype=np.float64, ensure_min_samples=2)
        self._check_number_of(rows)
        lower, upper = checked_sides(self.lower, self.upper, rows)
        scales = Scales.parse(self.scales, rows.shape[1])
        scales.require_positive(self._column_names(), rows, "X")
        lower = np.where(scales.log, np.maximum(lower, 0.0), lower)
        z = scales.forward(rows)
        standard = Standard.of(z, scales.forward(lower), scales.forward(upper))
        counts = None if weights is None else _checked_weights(weights, len(rows))
        events = Events(standard.forward(z), standard.box, counts)
        # The products are small and many: threads would only wait for each other.
        with threadpool_limits(limits=1, user_api="blas"):
            best, strength = self._best_fit(events, schedule, standard)
        self._n_events, self._sides, self._scales = events.n, (lower, upper), scales
        jacobian = scales.log_jacobian(z)
        total = jacobian.sum() if counts is None else counts @ jacobian
        self._keep(best, strength, standard, float(total))
        if not best.converged:
            warnings.warn(
                f"not converged in {self.n_iter_} steps: the next still promises a gain of "
                f"{best.promise:.2g} in log likelihood per event (tol = {self.tol:.2g}); raise "
                "max_iter, tol or prior_strength, or lower n_components.",
                ConvergenceWarning,
                stacklevel=2,
            )
        return self

    def _schedule(self) -> Schedule:
        """The parameters of the climb, checked."""
        known = [a.value for a in Algorithm]
        if self.algorithm not in known:
            raise InvalidInputError(
                f"algorithm: expected one of {', '.join(known)}, got {self.algorithm!r}."
            )
        for name, least in (("n_components", 1), ("max_iter", 1), ("n_init", 1)):
            value = getattr(self, name)
            if int(value) != value or value < least:
                raise InvalidInputError(f"{name}: expected an integer >= {least}, got {value!r}.")
        for name in ("tol", "prior_strength"):
            value = getattr(self, name)
            if not 0.0 <= value < math.inf:
                raise InvalidInputError(f"{name}: expected a number >= 0, got {value!r}.")
        return Schedule(Algorithm(self.algorithm), self.tol, int(self.max_iter))

    def _check_number_of(self, rows: FloatArray) -> None:
        if len(rows) < self.n_components:
            raise InvalidInputError(
                f"X: expected at least n_components = {self.n_components} events, "
                f"got n_samples = {len(rows)}."
            )

    def _best_fit(
        self, events: Events, schedule: Schedule, standard: Standard
    ) -> tuple[Fit, float]:
        """The best of `n_init` fits, with the prior it took."""
        rng = np.random.default_rng(check_random_state(self.random_state).randint(2**31))
        fits = [self._sane_fit(events, schedule, standard, rng) for _ in range(self.n_init)]
        return max(fits, key=lambda pair: pair[0].mixture.objective)

    def _sane_fit(
        self, events: Events, schedule: Schedule, standard: Standard, rng: np.random.Generator
    ) -> tuple[Fit, float]:
        """A fit without components that ran away; the prior grows until there is one."""
        start = self._start(events, standard, rng)
        covariance = standard.correlation + _RIDGE * np.eye(events.d)
        strength = self.prior_strength
        for _ in range(_MAX_GROWTHS):
            prior = Prior(strength, np.zeros(events.d), covariance)
            fit = fit_mixture(events, prior, start, schedule)
            drift = standard.drift(fit.mixture.components.means)
            if strength == 0.0 or drift <= _MAX_DRIFT:
                return fit, strength
            strength *= _PRIOR_GROWTH
        raise NumericalError(
            f"fit: a component's mean ran {drift:.0f} standard deviations out of the box even "
            f"with a prior of {strength / _PRIOR_GROWTH:.0f} events; use fewer components."
        )

    def _start(self, events: Events, standard: Standard, rng: np.random.Generator) -> Start:
        """k-means++, with what the user gave in its place."""
        k, d = int(self.n_components), events.d
        start = k_means_start(events.rows, k, rng)
        weights = self._given("weights_init", (k,))
        means = self._given("means_init", (k, d))
        precisions = self._given("precisions_init", (k, d, d))
        return Start(
            start.weights if weights is None else weights / weights.sum(),
            start.means if means is None else standard.forward(means),
            start.covariances
            if precisions is None
            else standard.forward_covariances(np.asarray(np.linalg.inv(precisions), float)),
        )

    def _given(self, name: str, shape: tuple[int, ...]) -> FloatArray | None:
        """A part of the start that the user gave, checked, or None."""
        value = getattr(self, name)
        if value is None:
            return None
        array = np.asarray(value, float)
        if array.shape != shape or not np.isfinite(array).all():
            raise InvalidInputError(
                f"{name}: expected finite numbers of shape {shape}, got shape {array.shape}."
            )
        return array

    def _keep(self, best: Fit, strength: float, standard: Standard, log_jacobian: float) -> None:
        """Store the results, in the units of the data; `log_jacobian` is that of all events."""
        parts = best.mixture.components
        weights = np.exp(best.mixture.log_weights)
        self.weights_ = weights / weights.sum()
        self.means_ = standard.back(parts.means)
        self.covariances_ = standard.back_covariances(parts.covariances)
        self.converged_ = best.converged
        self.n_iter_ = len(best.objectives) - 1
        self.lower_bound_ = best.mixture.objective
        self.lower_bounds_ = list(best.objectives)
        self.promise_ = best.promise
        self.n_safeguarded_ = best.n_safeguarded
        self.prior_strength_ = strength
        n = self._n_events
        in_z = best.mixture.expectation.log_likelihood - n * float(np.log(standard.scale).sum())
        self.log_likelihood_ = in_z + log_jacobian
        price = math.log(n)
        self.bic_ = -2.0 * self.log_likelihood_ + price * self._n_parameters()
        try:
            self.model_ = self.traffic_model()
        except InvalidInputError as error:  # the fit's doing, not the user's: no mass in the box
            raise NumericalError(f"fit: no usable law came of it: {error}") from None

    def traffic_model(self, names: Sequence[str] | None = None) -> TrafficModel:
        """The fitted law as a frozen value.

        Parameters
        ----------
        names : sequence of str, optional
            Names of the variables; by default the data frame's columns where they are
            identifiers, else x0, x1, ...
        """
        check_is_fitted(self, "weights_")
        if names is None:
            names = self._column_names()
        provenance = {
            "fitted": "crashrate TruncatedGaussianMixture",
            "algorithm": str(self.algorithm),
            "n_events": self._n_events,
            "log_likelihood": self.log_likelihood_,
            "bic": self.bic_,
            "converged": self.converged_,
            "n_iter": self.n_iter_,
            "promise": self.promise_,
            "prior_strength": self.prior_strength_,
        }
        lower, upper = self._sides
        return TrafficModel(
            self.weights_, self.means_, self.covariances_, lower, upper,
            tuple(str(name) for name in names), provenance, self._scales,
        )  # fmt: skip

    def _column_names(self) -> Sequence[str]:
        """The data frame's columns where they can be names of variables, else x0, x1, ..."""
        names = [str(name) for name in getattr(self, "feature_names_in_", ())]
        good = names and all(name.isidentifier() for name in names)
        return names if good else default_names(self.n_features_in_)

    def _n_parameters(self) -> int:
        """K - 1 weights, K d means and K d (d + 1) / 2 covariances."""
        k, d = self.means_.shape
        return int(k - 1 + k * d + k * d * (d + 1) // 2)

    def _rows(self, X: npt.ArrayLike) -> FloatArray:
        check_is_fitted(self, "weights_")
        rows: FloatArray = validate_data(self, X, dtype=np.float64, reset=False)
        return rows

    def score_samples(self, X: npt.ArrayLike) -> FloatArray:
        """Log density (n,) of rows X (n, d); -inf outside the box."""
        rows = self._rows(X)
        return self.model_.log_density(rows)

    def score(self, X: npt.ArrayLike, y: object = None) -> float:
        """Mean log density of rows X (n, d)."""
        del y
        return float(self.score_samples(X).mean())

    def bic(self, X: npt.ArrayLike) -> float:
        """Bayesian information criterion on X (n, d); the lower the better."""
        log_density = self.score_samples(X)
        return float(-2.0 * log_density.sum() + self._n_parameters() * math.log(len(log_density)))

    def aic(self, X: npt.ArrayLike) -> float:
        """Akaike information criterion on X (n, d); the lower the better."""
        return float(-2.0 * self.score_samples(X).sum() + 2.0 * self._n_parameters())

    def predict_proba(self, X: npt.ArrayLike) -> FloatArray:
        """Probability (n, K) that each row came from each component (paper, eq. 3)."""
        rows = self._rows(X)
        return self.model_.component_probabilities(rows)

    def predict(self, X: npt.ArrayLike) -> npt.NDArray[np.int64]:
        """Likeliest component (n,) of each row."""
        return np.asarray(self.predict_proba(X).argmax(axis=1))

    def fit_predict(self, X: npt.ArrayLike, y: object = None) -> npt.NDArray[np.int64]:
        """Fit, then the likeliest component (n,) of each row."""
        return self.fit(X, y).predict(X)

    def sample(self, n_samples: int = 1) -> tuple[FloatArray, npt.NDArray[np.int64]]:
        """Draws (n, d) and the components (n,) they came from, grouped by component."""
        check_is_fitted(self, "weights_")
        if n_samples < 1:
            raise InvalidInputError(f"n_samples: expected an integer >= 1, got {n_samples}.")
        rng = np.random.default_rng(check_random_state(self.random_state).randint(2**31))
        return self.model_.sample_components(int(n_samples), rng)


def _checked_weights(weights: npt.ArrayLike, n: int) -> FloatArray:
    array = np.asarray(weights, dtype=np.float64)
    if array.shape != (n,) or not (np.isfinite(array).all() and (array >= 0).all() and array.any()):
        raise InvalidInputError(
            f"weights: expected {n} finite numbers >= 0, not all 0, got shape {array.shape}."
        )
    return array
