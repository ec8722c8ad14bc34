"""An ensemble of fits: the traffic models that the events allow, not only the likeliest.

The likelihood does not decide the tail: fits that it cannot tell apart differ by an order of
magnitude in the probability of a crash. Members differ in all that was chosen: in the events (the
Bayesian bootstrap, Rubin 1981), in the number of components among those admissible, and in the
start.
"""

import math
import multiprocessing
import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from sklearn.exceptions import ConvergenceWarning

from crashrate.errors import InvalidInputError, NumericalError
from crashrate.traffic.held_out import held_out_score
from crashrate.traffic.mixture import TruncatedGaussianMixture
from crashrate.traffic.model import TrafficModel
from crashrate.variables import FloatArray

MAX_RETRIES = 3
MAX_WORKERS = 8
_WORK_OF_A_WORKER = 1_000_000  # events times components: some four seconds
OnStep = Callable[[int, int, str], None]


@dataclass(frozen=True, slots=True)
class Task:
    """One fit.

    Parameters
    ----------
    n_components : int
    seed : int
        Of the start.
    bootstrap : int or None
        Seed of the events' weights; None counts every event once.
    held_out : int or None
        Seed of the events to hold out from a second fit; None makes no second one.
    """

    n_components: int
    seed: int
    bootstrap: int | None = None
    held_out: int | None = None


@dataclass(frozen=True, slots=True)
class Fitted:
    """What one fit found: its law, and how well it fits (`held_out`: events not seen, or nan)."""

    task: Task
    model: TrafficModel
    bic: float
    log_likelihood: float
    converged: bool
    held_out: float = math.nan


@dataclass(frozen=True, slots=True)
class Failed:
    """A fit that came to nothing, and why."""

    task: Task
    reason: str


def event_weights(n: int, seed: int) -> FloatArray:
    """Weights (n,) of the Bayesian bootstrap: exponential, their sum n."""
    weights = np.random.default_rng(seed).exponential(size=n)
    return np.asarray(weights * (n / weights.sum()))


def fit_task(task: Task, rows: FloatArray, parameters: dict[str, Any]) -> Fitted | Failed:
    """Fit one task's mixture to events (n, d); a bootstrap fit that fails starts elsewhere."""
    for _ in range(0 if task.bootstrap is None else MAX_RETRIES):
        try:
            return _fit(task, rows, parameters)
        except NumericalError:
            task = replace(task, seed=task.seed + 1)
    try:
        return _fit(task, rows, parameters)
    except NumericalError as error:  # a value: the other fits shall not end with this one
        return Failed(task, str(error))


def _fit(task: Task, rows: FloatArray, parameters: dict[str, Any]) -> Fitted:
    weights = None if task.bootstrap is None else event_weights(len(rows), task.bootstrap)
    mixture = TruncatedGaussianMixture(task.n_components, random_state=task.seed, **parameters)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # `converged` says it
        mixture.fit_weighted(rows, weights)
    model, seed = mixture.model_, task.held_out
    score = math.nan if seed is None else held_out_score(model, rows, parameters, seed)
    return Fitted(
        task, model, mixture.bic_, mixture.log_likelihood_, mixture.converged_, held_out=score
    )


def fit_tasks(
    tasks: Sequence[Task],
    rows: FloatArray,
    parameters: dict[str, Any],
    *,
    workers: int | None = 1,
    on_step: OnStep | None = None,
) -> list[Fitted | Failed]:
    """Fit every task, in `workers` processes; the results are the same whatever their number.

    Parameters
    ----------
    tasks : sequence of Task
    rows : ndarray (n, d)
        Events.
    parameters : dict
        Of :class:`TruncatedGaussianMixture`.
    workers : int or None
        None for as many as are worth their start, at most `MAX_WORKERS` or the cores there are.
    on_step : callable, optional
        Called as ``on_step(done, total, message)`` before the first fit and after each.

    Raises
    ------
    InvalidInputError
        If `workers` is below 1, or as of :class:`TruncatedGaussianMixture`.
    """
    if workers is not None and workers < 1:
        raise InvalidInputError(f"workers: expected an integer >= 1, got {workers}.")
    fits: dict[int, Fitted | Failed] = {}
    report = on_step or _silent
    report(0, len(tasks), "fitting")
    processes = min(workers or worthwhile_workers(tasks, len(rows)), max(len(tasks), 1))
    # the longest first: one that begins last would keep all other processes waiting
    order = sorted(range(len(tasks)), key=lambda i: -tasks[i].n_components)
    with _mapped(processes, rows, parameters) as run:
        for i, fit in zip(order, run([tasks[i] for i in order]), strict=True):
            fits[i] = fit
            report(len(fits), len(tasks), _told(fit))
    return [fits[i] for i in range(len(tasks))]


def worthwhile_workers(tasks: Sequence[Task], n_events: int) -> int:
    """Processes whose start, about a second each, is little beside what they have to do."""
    work = n_events * sum(task.n_components for task in tasks)
    return max(1, min(available_cores(), MAX_WORKERS, work // _WORK_OF_A_WORKER))


def available_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):  # not everywhere
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _told(fit: Fitted | Failed) -> str:
    what = f"{fit.task.n_components} components"
    return f"{what}: failed" if isinstance(fit, Failed) else f"{what}: BIC {fit.bic:.1f}"


def _silent(done: int, total: int, message: str) -> None:
    """No progress wanted."""


Run = Callable[[Sequence[Task]], Iterator[Fitted | Failed]]


@contextmanager
def _mapped(workers: int, rows: FloatArray, parameters: dict[str, Any]) -> Iterator[Run]:
    if workers == 1:
        yield lambda tasks: (fit_task(task, rows, parameters) for task in tasks)
        return
    context = multiprocessing.get_context("spawn")  # a fork may copy a lock that a thread holds
    with ProcessPoolExecutor(
        workers, mp_context=context, initializer=_remember, initargs=(rows, parameters)
    ) as pool:
        yield lambda tasks: pool.map(_fit_remembered, tasks)


# what a worker process was started with: sent once, not with every task
_REMEMBERED: list[tuple[FloatArray, dict[str, Any]]] = []


def _remember(rows: FloatArray, parameters: dict[str, Any]) -> None:
    _REMEMBERED[:] = [(rows, parameters)]


def _fit_remembered(task: Task) -> Fitted | Failed:
    return fit_task(task, *_REMEMBERED[0])


def member_tasks(n_members: int, admissible: Sequence[int], seed: int) -> list[Task]:
    """Bootstrap fits: the admissible numbers of components in turn, each from a start of its own.

    Parameters
    ----------
    n_members : int
    admissible : sequence of int
        Numbers of components.
    seed : int
    """
    if n_members < 0 or not admissible:
        raise InvalidInputError(
            "members: expected a number >= 0 and at least one number of components, got "
            f"{n_members} and {list(admissible)}."
        )
    words = np.random.SeedSequence(seed, spawn_key=(1,)).generate_state(2 * n_members)
    return [
        Task(admissible[i % len(admissible)], int(words[2 * i] >> 1), int(words[2 * i + 1]))
        for i in range(n_members)
    ]


def with_members(model: TrafficModel, fits: Sequence[Fitted]) -> TrafficModel:
    """`model` with itself and the fits as its members."""
    first = replace(model, members=(), provenance={"n_components": model.n_components})
    others = [
        replace(
            fit.model,
            names=model.names,
            provenance={
                "n_components": fit.task.n_components,
                "seed": fit.task.seed,
                "bootstrap": fit.task.bootstrap,
                "converged": fit.converged,
                "log_likelihood": fit.log_likelihood,
            },
        )
        for fit in fits
    ]
    return replace(model, members=(first, *others))
