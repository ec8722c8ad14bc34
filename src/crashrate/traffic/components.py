"""How many components: the Bayesian information criterion over a range of numbers."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from sklearn.exceptions import ConvergenceWarning

from crashrate.errors import InvalidInputError
from crashrate.traffic.ensemble import Fitted, OnStep, Task, fit_tasks
from crashrate.traffic.model import TrafficModel, default_names
from crashrate.variables import FloatArray, frozen

MIN_SPREAD = 10.0  # of the criterion: what no one takes for a difference (Kass & Raftery 1995)


@dataclass(frozen=True, slots=True, eq=False)
class ComponentSelection:
    """The curve of the criterion, and the fit at its lowest point.

    Attributes
    ----------
    candidates : tuple of int
        Numbers of components tried.
    bic : ndarray (n_candidates,)
        Bayesian information criterion of each one's best start, the lower the better.
    bic_restarts : ndarray (n_candidates, n_restarts)
        Of every start.
    log_likelihood : ndarray (n_candidates,)
        Log likelihood of the events under each.
    converged : tuple of bool
        Whether each fit converged.
    best : Fitted
        The fit with the lowest criterion.
    """

    candidates: tuple[int, ...]
    bic: FloatArray
    bic_restarts: FloatArray
    log_likelihood: FloatArray
    converged: tuple[bool, ...]
    best: Fitted

    @property
    def n_components(self) -> int:
        """The number of components with the lowest criterion."""
        return self.candidates[int(np.argmin(self.bic))]

    @property
    def spread(self) -> float:
        """What the criterion owes to the start: median over the candidates of its range."""
        ranges = self.bic_restarts.max(axis=1) - self.bic_restarts.min(axis=1)
        return max(float(np.median(ranges)), MIN_SPREAD)

    @property
    def admissible(self) -> tuple[int, ...]:
        """Numbers that the criterion does not tell from the best by more than the spread."""
        near = self.bic <= self.bic.min() + self.spread
        return tuple(k for k, is_near in zip(self.candidates, near, strict=True) if is_near)

    def traffic_model(self, names: Sequence[str] | None = None) -> TrafficModel:
        """The best fit's law, the whole curve in its provenance."""
        model = self.best.model
        curve = {
            "n_components": list(self.candidates),
            "bic": self.bic.tolist(),
            "bic_restarts": self.bic_restarts.tolist(),
            "log_likelihood": self.log_likelihood.tolist(),
            "converged": list(self.converged),
            "admissible": list(self.admissible),
        }
        return replace(
            model,
            names=tuple(names or default_names(model.n_variables)),
            provenance={**model.provenance, "selection": curve},
        )


def select_components(
    X: npt.ArrayLike,
    candidates: Sequence[int],
    *,
    n_restarts: int = 1,
    workers: int = 1,
    random_state: int = 0,
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
    n_restarts : int
        Fits of each, from different starts.
    workers : int
        Processes; the result is the same whatever their number.
    random_state : int
        Seed of the starts.
    on_step : callable, optional
        Called as ``on_step(done, total, message)`` before the first fit and after each.
    **parameters
        Of :class:`TruncatedGaussianMixture`, such as `lower` and `upper`.

    Raises
    ------
    InvalidInputError
        If there are no candidates, or one comes twice, or n_restarts or workers is below 1.

    Warns
    -----
    ConvergenceWarning
        If the fit that is kept did not converge.
    """
    numbers = tuple(int(k) for k in candidates)
    if not numbers or len(set(numbers)) < len(numbers):
        raise InvalidInputError(
            f"candidates: expected different numbers of components, got {list(candidates)}."
        )
    if n_restarts < 1:
        raise InvalidInputError(f"n_restarts: expected an integer >= 1, got {n_restarts}.")
    tasks = [Task(k, _start_seed(random_state, k, r)) for k in numbers for r in range(n_restarts)]
    rows = np.asarray(X, dtype=np.float64)
    fits = fit_tasks(tasks, rows, parameters, workers=workers, on_step=on_step)
    groups = [fits[i : i + n_restarts] for i in range(0, len(fits), n_restarts)]
    best = [min(group, key=lambda fit: fit.bic) for group in groups]
    bic = np.array([fit.bic for fit in best])
    kept = best[int(np.argmin(bic))]
    if not kept.converged:
        warnings.warn(
            f"the fit of {kept.task.n_components} components did not converge; lower the number "
            "of components, or give more events.",
            ConvergenceWarning,
            stacklevel=2,
        )
    return ComponentSelection(
        numbers,
        frozen(bic),
        frozen([[fit.bic for fit in group] for group in groups]),
        frozen([fit.log_likelihood for fit in best]),
        tuple(fit.converged for fit in best),
        kept,
    )


def _start_seed(seed: int, n_components: int, restart: int) -> int:
    """Seed of one start: the first is `seed` itself, as of a single fit."""
    if restart == 0:
        return seed
    key = (2, n_components, restart)
    return int(np.random.SeedSequence(seed, spawn_key=key).generate_state(1)[0] >> 1)
