"""The pool: many cheap draws that carry the traffic model's probability where it matters.

Drawing from a density costs nothing; simulating does. Each round draws a pool, and the few
situations to simulate are chosen from it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.special import logsumexp

from crashrate.traffic.model import TrafficModel
from crashrate.variables import FloatArray


class Density(Protocol):
    """Something one can draw from and evaluate."""

    def sample(self, n: int, rng: np.random.Generator) -> FloatArray:
        """`n` draws, shape (n, d)."""

    def log_density(self, x: FloatArray) -> FloatArray:
        """Log density at `x` (n, d), shape (n,)."""


@dataclass(frozen=True)
class Blend:
    """A mixture of densities with given shares.

    Parameters
    ----------
    shares : tuple of float
        Positive, sum to one.
    densities : tuple of Density
    """

    shares: tuple[float, ...]
    densities: tuple[Density, ...]

    def sample(self, n: int, rng: np.random.Generator) -> FloatArray:
        """`n` draws: each density gets its share of them, up to rounding by lot."""
        counts = _split(n, np.array(self.shares), rng)
        parts = [d.sample(int(c), rng) for d, c in zip(self.densities, counts, strict=True) if c]
        return np.concatenate(parts)

    def log_density(
        self, x: FloatArray, known: tuple[Density, FloatArray] | None = None
    ) -> FloatArray:
        """Log density at `x` (n, d), shape (n,); `known`: a density with its own there, if any."""
        known_density, known_log = known or (None, None)
        logs = [known_log if d is known_density else d.log_density(x) for d in self.densities]
        log_density: FloatArray = logsumexp(np.log(self.shares)[:, None] + logs, axis=0)
        return log_density


@dataclass(frozen=True)
class Pool:
    """Draws from a proposal, inside the traffic model's box.

    Parameters
    ----------
    x : ndarray, shape (n, d)
        Draws inside the box.
    u : ndarray, shape (n, m)
        Their risk coordinates.
    log_f, log_q : ndarray, shape (n,)
        Log density of traffic and of the proposal.
    n_drawn : int
        Draws made, those outside the box included: their weight is zero.
    ratios : ndarray or None, shape (n, M)
        Densities of the traffic model's members over f; None where it has none.
    """

    x: FloatArray
    u: FloatArray
    log_f: FloatArray
    log_q: FloatArray
    n_drawn: int
    ratios: FloatArray | None = None

    @property
    def weights(self) -> FloatArray:
        """f / (n q): sums of these estimate probabilities under the traffic model."""
        return np.exp(self.log_f - self.log_q) / self.n_drawn


def draw_pool(
    proposal: Density,
    traffic: TrafficModel,
    coordinates: Callable[[FloatArray], FloatArray],
    n: int,
    rng: np.random.Generator,
    *,
    ensemble: TrafficModel | None = None,
) -> Pool:
    """`n` draws from `proposal`, those inside the traffic model's box kept.

    Parameters
    ----------
    proposal : Density
        May reach beyond the box.
    traffic : TrafficModel
    coordinates : callable
        x (n, d) to risk coordinates (n, m).
    n : int
    rng : Generator
    ensemble : TrafficModel, optional
        The model with members whose average `traffic` is.
    """
    x = proposal.sample(n, rng)
    x = x[traffic.contains(x)]
    # the density of an average of forty fits is what a pool costs: once for all that needs it
    if ensemble is None:
        log_f, ratios = traffic.log_density(x), None
    else:
        log_f, ratios = ensemble.member_densities(x)
    log_q = (
        proposal.log_density(x, (traffic, log_f))
        if isinstance(proposal, Blend)
        else proposal.log_density(x)
    )
    return Pool(x, coordinates(x), log_f, log_q, n, ratios)


def _split(n: int, shares: FloatArray, rng: np.random.Generator) -> np.ndarray:
    # Shares by count lower the variance and leave weights f / Σ share·q unbiased (Veach & Guibas
    # 1995, balance heuristic) as long as the expected counts are n·share: the remainder by lot.
    counts = np.floor(n * shares).astype(int)
    left = n * shares - counts
    missing = n - counts.sum()
    if missing:
        chosen = _systematic(left, rng)
        counts[chosen] += 1
    return counts


def _systematic(inclusion: FloatArray, rng: np.random.Generator) -> np.ndarray:
    """Indices chosen with the given inclusion probabilities, whose sum is a whole number."""
    edges = np.cumsum(inclusion)
    ticks = rng.random() + np.arange(round(float(edges[-1])))
    return np.minimum(np.searchsorted(edges, ticks), len(inclusion) - 1)
