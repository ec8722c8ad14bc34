"""One fit of a truncated mixture from one start: steps until they gain nothing more."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from crashrate.errors import NumericalError
from crashrate.traffic.em import information_em_step, lee_scott_step
from crashrate.traffic.natural import to_natural
from crashrate.traffic.objective import Events, Mixture, Prior, mixture_at
from crashrate.traffic.quasi_newton import QuasiNewton, gain_promised
from crashrate.traffic.start import Start
from crashrate.traffic.truncated_components import components_at, sound, usable

_N_PART, _MANY = 30_000, 3  # events of a first fit, made where there are so many times more
_ROUGH_TOL = 1e-6  # of it: what it gains beyond, the rest of the events takes back
_N_EM = 15  # EM steps before the quasi-Newton ones: far from the answer they are the safer
_N_SMALL = 3  # gains below the tolerance in a row that mean convergence
_N_STUCK = 30  # ... and that mean that there is no way on
_MAX_INFLATIONS = 12
_ROUNDING = 1e-10


class Algorithm(StrEnum):
    """How the likelihood is climbed."""

    QUASI_NEWTON = "quasi-newton"
    LEE_SCOTT = "lee-scott"


@dataclass(frozen=True, slots=True)
class Schedule:
    """When a fit stops: gains per step below `tol`, or `max_iter` steps; the first are EM's."""

    algorithm: Algorithm
    tol: float
    max_iter: int
    n_em: int = _N_EM


@dataclass(frozen=True, slots=True)
class Fit:
    """Where a fit ended.

    Attributes
    ----------
    mixture : Mixture
    objectives : tuple of float
        Penalised log likelihood per event at the start and after every step: never falling.
    converged : bool
    promise : float
        Gain per event that the slope at the end still promises one step.
    n_safeguarded : int
        Components whose step was shortened or replaced, summed over EM steps.
    """

    mixture: Mixture
    objectives: tuple[float, ...]
    converged: bool
    promise: float
    n_safeguarded: int


def fit_mixture(events: Events, prior: Prior, start: Start, schedule: Schedule) -> Fit:
    """Climb from `start` as `schedule` says, where events are many first on a part of them.

    Most steps of a fit cross plateaus that a part of the events shows as well, for less.

    Raises
    ------
    NumericalError
        If the start, however widened, is no usable mixture.
    """
    if schedule.algorithm is Algorithm.LEE_SCOTT or len(events.rows) < _MANY * _N_PART:
        return fit_from(events, prior, start, schedule)
    early = replace(schedule, tol=max(schedule.tol, _ROUGH_TOL))
    try:
        rough = fit_from(events.part(_N_PART), prior, start, early).mixture
    except NumericalError:  # so few events hold no such mixture: all of them may
        return fit_from(events, prior, start, schedule)
    parts = rough.components
    near = Start(np.exp(rough.log_weights), parts.means, parts.covariances)
    return fit_from(events, prior, near, replace(schedule, n_em=0))


def fit_from(events: Events, prior: Prior, start: Start, schedule: Schedule) -> Fit:
    """Climb from `start` as `schedule` says.

    Raises
    ------
    NumericalError
        If the start, however widened, is no usable mixture.
    """
    climb = _climber(events, prior, schedule)
    mixture = _first(events, prior, start)
    objectives = [mixture.objective]
    new: Mixture | None = mixture
    n_small = n_safeguarded = 0
    enough = max(_N_SMALL * schedule.tol, _ROUNDING)
    for i in range(schedule.max_iter):
        new, n_events = climb(i, mixture)
        n_safeguarded += n_events
        if new is None:  # no step gains anything
            break
        gain = new.objective - mixture.objective
        if gain >= 0.0:  # rounding may take back the last digit of a converged EM step
            mixture = new
        objectives.append(mixture.objective)
        n_small = n_small + 1 if gain < schedule.tol else 0
        if n_small >= _N_SMALL and gain_promised(events, prior, mixture) <= enough:
            break
        if n_small >= _N_STUCK:
            break
    # Small gains are not enough: EM crawls, and a climb may be stuck against what arithmetic
    # can hold. The slope tells.
    promise = gain_promised(events, prior, mixture)
    converged = (new is None or n_small >= _N_SMALL) and promise <= enough
    return Fit(mixture, tuple(objectives), converged, promise, n_safeguarded)


Climb = Callable[[int, Mixture], tuple[Mixture | None, int]]


def _climber(events: Events, prior: Prior, schedule: Schedule) -> Climb:
    """The function that makes step i of the schedule."""
    quasi_newton = QuasiNewton(events, prior)

    def climb(i: int, mixture: Mixture) -> tuple[Mixture | None, int]:
        if schedule.algorithm is Algorithm.LEE_SCOTT:
            step = lee_scott_step(events, prior, mixture)
        elif i < schedule.n_em:
            step = information_em_step(events, prior, mixture)
        else:
            return quasi_newton.step(mixture), 0
        return step.mixture, step.n_safeguarded

    return climb


def _first(events: Events, prior: Prior, start: Start) -> Mixture:
    """The start as a mixture, widened towards the data's covariance until it is a usable one."""
    means, covariances = start.means, start.covariances
    with np.errstate(divide="ignore"):  # weight 0 is a component that takes no part
        log_weights = np.log(start.weights)
    for _ in range(_MAX_INFLATIONS):
        theta = to_natural(means, covariances)
        if usable(theta, events.d).all():
            components = components_at(theta, events.box)
            if sound(components).all():
                return mixture_at(events, prior, log_weights, components)
        covariances = 0.7 * covariances + 0.3 * (prior.covariance + 1e-3 * np.eye(events.d))
    raise NumericalError(
        "fit: expected a start with every component's mass partly in the box; got one that stays "
        "numerically singular; give other starting values, or a larger prior_strength."
    )
