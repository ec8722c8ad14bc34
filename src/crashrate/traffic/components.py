"""How many components: the Bayesian information criterion over a range of numbers.

Beside it stands the held-out log likelihood, which needs no theory of how much a parameter costs.
"""

import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from sklearn.exceptions import ConvergenceWarning

from crashrate.errors import InvalidInputError, NumericalError
from crashrate.traffic.ensemble import Failed, Fitted, OnStep, Task, fit_tasks
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
        Of every start; nan where it failed.
    held_out : ndarray (n_candidates, n_restarts)
        Mean log density, in the units of the data, of the events that a fit of the others did not
        see: about a fifth, the same for every candidate of one column; nan where there is none.
        Empty, (n_candidates, 0), where a single number was tried: there is nothing to compare.
    log_likelihood : ndarray (n_candidates,)
        Log likelihood of the events under each.
    converged : tuple of bool
        Whether each fit converged.
    best : Fitted
        The fit with the lowest criterion.
    left_out : tuple of int
        Numbers that were tried and none of whose starts came to a fit: no candidates.
    """

    candidates: tuple[int, ...]
    bic: FloatArray
    bic_restarts: FloatArray
    held_out: FloatArray
    log_likelihood: FloatArray
    converged: tuple[bool, ...]
    best: Fitted
    left_out: tuple[int, ...] = ()

    @property
    def n_components(self) -> int:
        """The number of components with the lowest criterion."""
        return self.candidates[int(np.argmin(self.bic))]

    @property
    def spread(self) -> float:
        """What the criterion owes to the start: median over the candidates of its range."""
        ranges = np.nanmax(self.bic_restarts, axis=1) - np.nanmin(self.bic_restarts, axis=1)
        return max(float(np.median(ranges)), MIN_SPREAD)

    @property
    def n_failed(self) -> tuple[int, ...]:
        """How many starts of each candidate failed."""
        return tuple(int(n) for n in np.isnan(self.bic_restarts).sum(axis=1))

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
            "bic_restarts": _lists(self.bic_restarts),
            "held_out": _lists(self.held_out) if self.held_out.size else [],
            "n_failed": list(self.n_failed),
            "left_out": list(self.left_out),
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
    workers: int | None = 1,
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
    workers : int or None
        Processes; the result is the same whatever their number. None for as many as are worth it.
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
    NumericalError
        If every start of every candidate fails.

    Warns
    -----
    UserWarning
        If starts failed, or every start of a candidate.
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
    tasks = _tasks(numbers, n_restarts, random_state)
    rows = np.asarray(X, dtype=np.float64)
    fits = fit_tasks(tasks, rows, parameters, workers=workers, on_step=on_step)
    _tell_of_failures(fits)
    starts = {k: fits[i * n_restarts : (i + 1) * n_restarts] for i, k in enumerate(numbers)}
    selection = _selection(starts, held_out=len(numbers) > 1)
    if not selection.best.converged:
        warnings.warn(
            f"the fit of {selection.n_components} components did not converge; lower the number "
            "of components, or give more events.",
            ConvergenceWarning,
            stacklevel=2,
        )
    return selection


def _tasks(numbers: Sequence[int], n_restarts: int, seed: int) -> list[Task]:
    """Every number from every start; one start's split of the events is the same for all."""
    compared = len(numbers) > 1
    return [
        Task(k, _start_seed(seed, k, r), held_out=_word(seed, 3, r) if compared else None)
        for k in numbers
        for r in range(n_restarts)
    ]


def _start_seed(seed: int, n_components: int, restart: int) -> int:
    """Seed of one start: the first is `seed` itself, as of a single fit."""
    return _word(seed, 2, n_components, restart) if restart else seed


def _word(seed: int, *key: int) -> int:
    return int(np.random.SeedSequence(seed, spawn_key=key).generate_state(1)[0] >> 1)


def _tell_of_failures(fits: Sequence[Fitted | Failed]) -> None:
    """Warn once of failed starts; raise where there is no other.

    Raises
    ------
    NumericalError
        With the first failure's reason.
    """
    failed = [fit for fit in fits if isinstance(fit, Failed)]
    if not failed:
        return
    if len(failed) == len(fits):
        raise NumericalError(failed[0].reason)
    counts = Counter(fit.task.n_components for fit in failed)
    told = ", ".join(f"{n} of {k} components" for k, n in counts.items())
    warnings.warn(
        f"{len(failed)} of {len(fits)} fits failed ({told}); the others count. The first: "
        f"{failed[0].reason}",
        stacklevel=3,
    )


def _selection(
    starts: Mapping[int, Sequence[Fitted | Failed]], *, held_out: bool
) -> ComponentSelection:
    """What the fits from all starts of every number say."""
    found = {k: [fit for fit in fits if isinstance(fit, Fitted)] for k, fits in starts.items()}
    numbers = tuple(k for k, fits in found.items() if fits)
    best = [min(found[k], key=lambda fit: fit.bic) for k in numbers]
    scores = frozen([[getattr(fit, "held_out", np.nan) for fit in starts[k]] for k in numbers])
    return ComponentSelection(
        candidates=numbers,
        bic=frozen([fit.bic for fit in best]),
        bic_restarts=frozen([[getattr(fit, "bic", np.nan) for fit in starts[k]] for k in numbers]),
        held_out=scores if held_out else scores[:, :0],
        log_likelihood=frozen([fit.log_likelihood for fit in best]),
        converged=tuple(fit.converged for fit in best),
        best=min(best, key=lambda fit: fit.bic),
        left_out=tuple(k for k in starts if k not in numbers),
    )


def _lists(values: FloatArray) -> list[list[float | None]]:
    """Rows as JSON can hold them, which knows no nan."""
    return [[None if np.isnan(x) else float(x) for x in row] for row in values]
