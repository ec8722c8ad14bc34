"""The penalised log likelihood of a truncated mixture, one blocked pass over the events."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from crashrate.traffic import quadratic
from crashrate.traffic.natural import expectations
from crashrate.traffic.one_dimension import ROUGH
from crashrate.traffic.truncated_components import Box, Components
from crashrate.variables import FloatArray

# Features of all events are kept when they are at most this many numbers (0.5 GB).
_MAX_KEPT = 64_000_000


@dataclass(frozen=True, slots=True)
class Expectation:
    """What one pass over the events gives at a mixture.

    Attributes
    ----------
    counts : ndarray (K,)
        Expected number of events of each component.
    sums : ndarray (K, q)
        Expected sums of s(y) over the events of each component.
    log_likelihood : float
    """

    counts: FloatArray
    sums: FloatArray
    log_likelihood: float


class Events:
    """Standardised events, as features in blocks; made once, read in every pass.

    Parameters
    ----------
    y : ndarray (n, d)
    box : Box
    weights : ndarray (n,), optional
        How often each event counts; once by default. `n` is their sum.
    """

    def __init__(self, y: FloatArray, box: Box, weights: FloatArray | None = None) -> None:
        self.d = y.shape[1]
        self.n = len(y) if weights is None else float(weights.sum())
        self.box = box
        self.rows = y
        self._weights = weights
        n_numbers = len(y) * quadratic.n_features(self.d)
        self._blocks = list(self._made_blocks()) if n_numbers <= _MAX_KEPT else None

    def part(self, n: int) -> "Events":
        """About `n` of them, evenly spread over the rows, to be integrated roughly."""
        some = slice(None, None, max(1, len(self.rows) // n))
        weights = None if self._weights is None else self._weights[some]
        return Events(self.rows[some], replace(self.box, rule=ROUGH), weights)

    def _made_blocks(self) -> Iterator[FloatArray]:
        for block in quadratic.blocks(len(self.rows)):
            yield quadratic.features(self.rows[block])

    def expectation(self, log_weights: FloatArray, components: Components) -> Expectation:
        """E-step (paper, eq. 3) with its sums, never holding N x K numbers."""
        table = self._table(log_weights, components)
        sums = np.zeros_like(table)
        log_likelihood = 0.0
        features_of = self._blocks if self._blocks is not None else self._made_blocks()
        for block, features in zip(quadratic.blocks(len(self.rows)), features_of, strict=True):
            terms = table @ features
            log_density = quadratic.log_sum(terms)
            if self._weights is not None:
                log_density *= self._weights[block]
                terms *= self._weights[block]
            log_likelihood += float(log_density.sum())
            sums += terms @ features.T
        sums[:, 1 + self.d :] *= quadratic.pair_factors(self.d)
        return Expectation(sums[:, 0], sums[:, 1:], log_likelihood)

    def _table(self, log_weights: FloatArray, components: Components) -> FloatArray:
        """Coefficients (K, 1 + q) of log w_k g_k in the features."""
        scaled = components.theta.copy()
        scaled[:, self.d :] *= quadratic.pair_factors(self.d)
        return np.hstack([(log_weights - components.log_partition)[:, None], scaled])


@dataclass(frozen=True, slots=True)
class Prior:
    """A conjugate prior: each component has seen `strength` events of an untruncated normal.

    Attributes
    ----------
    strength : float
        Pseudo-events per component; 0 for none.
    mean, covariance : ndarray (d,), (d, d)
        Their moments, those of the data.
    """

    strength: float
    mean: FloatArray
    covariance: FloatArray

    @property
    def expected(self) -> FloatArray:
        """E s(y) (q,) of the pseudo-events."""
        return np.asarray(expectations(self.mean[None], self.covariance[None])[0])

    def log_density(self, components: Components) -> FloatArray:
        """Log prior (K,) of each component, up to a constant."""
        inner = components.theta @ self.expected - components.prior_log_partition
        return np.asarray(self.strength * inner)

    def gradient(self, components: Components) -> FloatArray:
        """Its gradient (K, q) in theta."""
        return np.asarray(self.strength * (self.expected - components.prior_expected))


@dataclass(frozen=True, slots=True)
class Mixture:
    """A mixture at one step of a fit, with the pass over the events at it.

    Attributes
    ----------
    log_weights : ndarray (K,)
    components : Components
    expectation : Expectation
    objective : float
        Penalised log likelihood per event.
    """

    log_weights: FloatArray
    components: Components
    expectation: Expectation
    objective: float


def mixture_at(
    events: Events, prior: Prior, log_weights: FloatArray, components: Components
) -> Mixture:
    """One pass over the events at these weights and components."""
    expectation = events.expectation(log_weights, components)
    total = expectation.log_likelihood + float(prior.log_density(components).sum())
    return Mixture(log_weights, components, expectation, total / events.n)


def theta_gradient(prior: Prior, mixture: Mixture) -> FloatArray:
    """Gradient (K, q) of the penalised log likelihood in the natural parameters."""
    parts, seen = mixture.components, mixture.expectation
    moments = seen.sums - seen.counts[:, None] * parts.expected
    return np.asarray(moments + prior.gradient(parts))


def information_step(prior: Prior, mixture: Mixture, gradient: FloatArray) -> FloatArray:
    """Gradient (K, q) over each component's complete-data information block."""
    parts = mixture.components
    # An almost empty component has no information of its own: one event's keeps it solvable.
    counts = np.maximum(mixture.expectation.counts, 1.0)[:, None, None]
    blocks = counts * parts.information + prior.strength * parts.prior_information
    size = np.sqrt(np.diagonal(blocks, axis1=1, axis2=2))
    scaled = blocks / (size[:, :, None] * size[:, None, :])
    scaled += 1e-10 * np.eye(blocks.shape[1])  # rounding may leave it singular
    return np.asarray(np.linalg.solve(scaled, (gradient / size)[..., None])[..., 0] / size)
