"""EM for the truncated mixture, in steps that cannot lower the likelihood.

The E-step is the paper's eq. 3. Given it, the penalised log likelihood of each component,
Q_k(theta) = n_k (theta . sbar - A(theta)) + log prior, is concave in theta. The M-step of the
paper (eqs. 4-8, after Lee and Scott 2012) is a fixed-point step towards its maximum that may
overshoot. A step that lowers Q_k is therefore shortened, and one that does not even point
uphill is replaced by a step along the information-scaled gradient: raising every Q_k raises
the likelihood.
"""

from dataclasses import dataclass

import numpy as np

from crashrate.traffic.natural import to_natural
from crashrate.traffic.objective import (
    Events,
    Mixture,
    Prior,
    information_step,
    mixture_at,
    theta_gradient,
)
from crashrate.traffic.quadratic import pair_factors, pairs
from crashrate.traffic.truncated_components import Box, Components, components_at, sound, usable
from crashrate.variables import BoolArray, FloatArray

_MAX_HALVINGS = 30
_MAX_LOG_MASS_STEP = 3.0
_ROUNDING = 1e-12
_SUFFICIENT = 0.1  # share of the gain that a Newton step must keep of what its slope promises


@dataclass(frozen=True, slots=True)
class Step:
    """A mixture after a step, and how many components had their step shortened or replaced."""

    mixture: Mixture
    n_safeguarded: int


def lee_scott_step(events: Events, prior: Prior, mixture: Mixture) -> Step:
    """One EM step with the paper's M-step, safeguarded."""
    means, covariances = lee_scott_target(prior, mixture)
    gradient = theta_gradient(prior, mixture)
    uphill = information_step(prior, mixture, gradient)
    definite = np.asarray(np.isfinite(covariances).all(axis=(1, 2)))
    definite[definite] = np.linalg.eigvalsh(covariances[definite])[:, 0] > 0.0
    step = uphill.copy()
    step[definite] = (
        to_natural(means[definite], covariances[definite]) - mixture.components.theta[definite]
    )
    downhill = (step * gradient).sum(axis=1) < -_ROUNDING * events.n
    step[downhill] = uphill[downhill]
    return _safeguarded(events, prior, mixture, step, ~definite | downhill, promise=0.0)


def lee_scott_target(prior: Prior, mixture: Mixture) -> tuple[FloatArray, FloatArray]:
    """Means (K, d) and covariances (K, d, d) of the paper's M-step, with the prior's events."""
    parts, seen = mixture.components, mixture.expectation
    d = parts.means.shape[1]
    n = np.maximum(seen.counts, np.finfo(float).tiny)[:, None]
    centre = seen.sums[:, :d] / n
    second = np.empty_like(parts.covariances)
    i, j = pairs(d)
    second[:, i, j] = second[:, j, i] = seen.sums[:, d:] / (n * pair_factors(d))
    m = parts.box_means - parts.means  # (eq. 7)
    h = parts.covariances - parts.box_covariances - m[:, :, None] * m[:, None, :]  # (eq. 8)
    own = n / (n + prior.strength)  # the prior's events are not truncated: no correction
    means = own * (centre - m) + (1.0 - own) * prior.mean  # (eq. 5)
    cross = centre[:, :, None] * means[:, None, :]
    scatter = second - cross - cross.transpose(0, 2, 1) + means[:, :, None] * means[:, None, :]
    away = prior.mean - means
    prior_scatter = prior.covariance + away[:, :, None] * away[:, None, :]
    share = own[:, :, None]
    return means, share * (scatter + h) + (1.0 - share) * prior_scatter  # (eq. 6)


def information_em_step(events: Events, prior: Prior, mixture: Mixture) -> Step:
    """One EM step whose M-step is a Newton step on every Q_k, shortened where it overshoots."""
    gradient = theta_gradient(prior, mixture)
    step = information_step(prior, mixture, gradient)
    promise = _SUFFICIENT * (step * gradient).sum(axis=1)
    return _safeguarded(events, prior, mixture, step, np.zeros(len(step), bool), promise=promise)


def _safeguarded(
    events: Events,
    prior: Prior,
    mixture: Mixture,
    step: FloatArray,
    replaced: BoolArray,
    *,
    promise: FloatArray | float,
) -> Step:
    """Move each component by its step, halved until its Q_k gains its share of `promise`."""
    current = mixture.components
    before = _q(prior, mixture, current)
    before -= _ROUNDING * (np.abs(before) + 1.0)  # at its maximum Q_k moves by rounding alone
    accepted, shortened = current, replaced.copy()
    pending = np.ones(len(step), bool)
    scale = 1.0
    for _ in range(_MAX_HALVINGS):
        trial, good = trial_components(current, scale * step, pending, events.box)
        good &= _q(prior, mixture, trial) >= before + scale * promise
        accepted = accepted.replace(trial, good)
        pending &= ~good
        if not pending.any():
            break
        shortened |= pending
        scale *= 0.5
    # The maximum over the weights is the share of the events (eq. 4).
    counts = np.maximum(mixture.expectation.counts, np.finfo(float).tiny)
    log_weights = np.log(counts / counts.sum())
    return Step(mixture_at(events, prior, log_weights, accepted), int(shortened.sum()))


def trial_components(
    current: Components, step: FloatArray, pending: BoolArray, box: Box
) -> tuple[Components, BoolArray]:
    """Components moved by `step` where `pending` and possible, and where they were (K,)."""
    theta = current.theta + step
    moved = pending & usable(theta, len(box.lower))
    if not moved.any():
        return current, moved
    trial = components_at(np.where(moved[:, None], theta, current.theta), box)
    # A trust region: the quadratic model of a step knows nothing of a box far less likely.
    near = trial.log_masses > 2.0 * current.log_masses - _MAX_LOG_MASS_STEP
    return trial, moved & sound(trial) & near


def _q(prior: Prior, mixture: Mixture, components: Components) -> FloatArray:
    """Q_k (K,): expected complete-data log likelihood of each component, with its prior."""
    seen = mixture.expectation
    fit = (components.theta * seen.sums).sum(axis=1) - seen.counts * components.log_partition
    return np.asarray(fit + prior.log_density(components))
