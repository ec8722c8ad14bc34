"""How many components: the Bayesian information criterion over a range of numbers."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from crashrate.errors import InvalidInputError
from crashrate.traffic.mixture import TruncatedGaussianMixture
from crashrate.traffic.model import TrafficModel
from crashrate.variables import FloatArray, frozen

OnStep = Callable[[int, int, str], None]


@dataclass(frozen=True, slots=True, eq=False)
class ComponentSelection:
    """The curve of the criterion, and the fit at its lowest point.

    Attributes
    ----------
    candidates : tuple of int
        Numbers of components tried.
    bic : ndarray (n_candidates,)
        Bayesian information criterion of each, the lower the better.
    log_likelihood : ndarray (n_candidates,)
        Log likelihood of the events under each.
    converged : tuple of bool
        Whether each fit converged.
    best : TruncatedGaussianMixture
        The fitted estimator with the lowest criterion.
    """

    candidates: tuple[int, ...]
    bic: FloatArray
    log_likelihood: FloatArray
    converged: tuple[bool, ...]
    best: TruncatedGaussianMixture

    @property
    def n_components(self) -> int:
        """The number of components with the lowest criterion."""
        return self.candidates[int(np.argmin(self.bic))]

    def traffic_model(self, names: Sequence[str] | None = None) -> TrafficModel:
        """The best fit's law, the whole curve in its provenance."""
        model = self.best.traffic_model(names)
        curve = {
            "n_components": list(self.candidates),
            "bic": self.bic.tolist(),
            "log_likelihood": self.log_likelihood.tolist(),
            "converged": list(self.converged),
        }
        return TrafficModel(
            model.weights,
            model.means,
            model.covariances,
            model.lower,
            model.upper,
            model.names,
            {**model.provenance, "selection": curve},
            model.scales,
        )


def select_components(
    X: npt.ArrayLike,
    candidates: Sequence[int],
    *,
    on_step: OnStep | None = None,
    **parameters: Any,
) -> ComponentSelection:
    """Fit every number of components and keep the one with the lowest criterion.

    Parameters
    ----------
    X : array_like (n, d)
        Events.
    candidates : sequence of int
        Numbers of components to try.
    on_step : callable, optional
        Called as ``on_step(done, total, message)`` before the first fit and after each.
    **parameters
        Of :class:`TruncatedGaussianMixture`, such as `lower`, `upper` and `random_state`.

    Raises
    ------
    InvalidInputError
        If there are no candidates, or one comes twice.
    """
    numbers = tuple(int(k) for k in candidates)
    if not numbers or len(set(numbers)) < len(numbers):
        raise InvalidInputError(
            f"candidates: expected different numbers of components, got {list(candidates)}."
        )
    report: OnStep = on_step or _silent
    report(0, len(numbers), "fitting")
    fits: list[TruncatedGaussianMixture] = []
    for done, k in enumerate(numbers, start=1):
        fits.append(TruncatedGaussianMixture(k, **parameters).fit(X))
        report(done, len(numbers), f"{k} components: BIC {fits[-1].bic_:.1f}")
    bic = np.array([fit.bic_ for fit in fits])
    return ComponentSelection(
        numbers,
        frozen(bic),
        frozen([fit.log_likelihood_ for fit in fits]),
        tuple(fit.converged_ for fit in fits),
        fits[int(np.argmin(bic))],
    )


def _silent(done: int, total: int, message: str) -> None:
    """No progress wanted."""
