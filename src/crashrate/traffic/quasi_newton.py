"""L-BFGS on all natural parameters, preconditioned by the components' information blocks.

EM needs thousands of steps where components overlap or pile up at a side of the box. In natural
parameters, scaled by the complete-data information, what is left of the curvature is the missing
information alone, which a few dozen remembered steps describe [1]_.

References
----------
.. [1] M. Jamshidian and R. I. Jennrich, "Acceleration of the EM algorithm by using quasi-Newton
   methods", Journal of the Royal Statistical Society B 59 (1997) 569-587.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np

from crashrate.traffic.em import trial_components
from crashrate.traffic.objective import (
    Events,
    Mixture,
    Prior,
    information_step,
    mixture_at,
    theta_gradient,
)
from crashrate.variables import FloatArray

_MEMORY = 20
_MAX_SHRINKS = 14
_SHRINK = 0.35
_SUFFICIENT = 1e-4  # Armijo's share of the gain that the slope promises
_MAX_LOG_WEIGHT_STEP = 4.0
_MIN_WEIGHT = 1e-6


@dataclass(frozen=True, slots=True)
class _Pair:
    """A step taken and how the negative gradient changed along it."""

    step: FloatArray
    change: FloatArray
    inverse_product: float


def _gradient(events: Events, prior: Prior, mixture: Mixture) -> FloatArray:
    """Gradient (K, 1 + q) in (log weight, theta) of the penalised log likelihood."""
    by_weight = mixture.expectation.counts - events.n * np.exp(mixture.log_weights)
    return np.hstack([by_weight[:, None], theta_gradient(prior, mixture)])


def _preconditioned(
    events: Events, prior: Prior, mixture: Mixture, gradient: FloatArray
) -> FloatArray:
    """A gradient (K, 1 + q) over the information blocks of weights and components."""
    weights = np.maximum(np.exp(mixture.log_weights), _MIN_WEIGHT)
    by_weight = gradient[:, 0] / (events.n * weights)
    return np.hstack([by_weight[:, None], information_step(prior, mixture, gradient[:, 1:])])


def gain_promised(events: Events, prior: Prior, mixture: Mixture) -> float:
    """Gain per event that the slope promises one step of the blocks' length; 0 at the top."""
    gradient = _gradient(events, prior, mixture)
    step = _preconditioned(events, prior, mixture, gradient)
    return float((gradient * step).sum() / events.n)


class QuasiNewton:
    """The memory of an L-BFGS ascent; :meth:`step` makes one step of it."""

    def __init__(self, events: Events, prior: Prior) -> None:
        self._events = events
        self._prior = prior
        self._pairs: deque[_Pair] = deque(maxlen=_MEMORY)

    def step(self, mixture: Mixture) -> Mixture | None:
        """The mixture after one step uphill, or None where no step gains anything."""
        gradient = _gradient(self._events, self._prior, mixture)
        direction = self._direction(mixture, gradient)
        if float((direction * gradient).sum()) <= 0.0:
            self._pairs.clear()
            direction = self._direction(mixture, gradient)
        found = self._search(mixture, gradient, direction)
        if found is None and self._pairs:
            self._pairs.clear()
            direction = self._direction(mixture, gradient)
            found = self._search(mixture, gradient, direction)
        if found is None:
            return None
        scale, new = found
        self._remember(scale * direction, gradient - _gradient(self._events, self._prior, new))
        return new

    def _direction(self, mixture: Mixture, gradient: FloatArray) -> FloatArray:
        """The two-loop recursion with the information blocks as initial curvature."""
        rest = gradient.copy()
        shares = []
        for pair in reversed(self._pairs):
            share = pair.inverse_product * float((pair.step * rest).sum())
            shares.append(share)
            rest -= share * pair.change
        direction = _preconditioned(self._events, self._prior, mixture, rest)
        for pair, share in zip(self._pairs, reversed(shares), strict=True):
            back = pair.inverse_product * float((pair.change * direction).sum())
            direction += (share - back) * pair.step
        return direction

    def _search(
        self, mixture: Mixture, gradient: FloatArray, direction: FloatArray
    ) -> tuple[float, Mixture] | None:
        """Backtrack until the objective gains its share of what the slope promises."""
        slope = float((gradient * direction).sum()) / self._events.n
        largest = float(np.abs(direction[:, 0]).max())
        scale = min(1.0, _MAX_LOG_WEIGHT_STEP / largest) if largest > 0.0 else 1.0
        for _ in range(_MAX_SHRINKS):
            new = self._trial(mixture, scale * direction)
            if new and new.objective > mixture.objective + _SUFFICIENT * scale * slope:
                return scale, new
            scale *= _SHRINK
        return None

    def _trial(self, mixture: Mixture, step: FloatArray) -> Mixture | None:
        """The mixture moved by `step` (K, 1 + q), or None where that is no mixture."""
        every = np.ones(len(step), bool)
        components, good = trial_components(
            mixture.components, step[:, 1:], every, self._events.box
        )
        if not good.all():
            return None
        log_weights = mixture.log_weights + step[:, 0]
        top = log_weights.max()
        log_weights -= top + np.log(np.exp(log_weights - top).sum())
        return mixture_at(self._events, self._prior, log_weights, components)

    def _remember(self, step: FloatArray, change: FloatArray) -> None:
        """Keep the pair where it shows curvature of the right sign."""
        product = float((step * change).sum())
        if product > 1e-12 * self._events.n:
            self._pairs.append(_Pair(step, change, 1.0 / product))
