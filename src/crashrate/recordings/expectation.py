"""Draws of a law of traffic where it meets rare sets: importance sampling, no simulator."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from crashrate.sampling.gaussians import fit_gaussians
from crashrate.sampling.pool import Blend, Density
from crashrate.variables import BoolArray, FloatArray

N_DRAWS = 20_000
N_LAST = 4 * N_DRAWS  # of the draw that answers
N_STEPS = 3
N_FIT = 2000
N_COMPONENTS = 12
WIDEN = 1.5
SHARES = (0.7, 0.2, 0.1)  # fitted to the sets, the law itself (bounds the weights), wide
FIRST_SHARES = (0.4, 0.3, 0.3)


class Law(Density, Protocol):
    """A law of traffic: to draw from, to evaluate, on a box."""

    def contains(self, x: FloatArray) -> BoolArray:
        """Which rows (n, d) lie in its box: (n,)."""


Sets = Callable[[FloatArray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Draws:
    """Weighted draws inside J disjoint sets.

    Parameters
    ----------
    x : ndarray (n, d)
    weights : ndarray (n,)
        Sums of them estimate probabilities under the law.
    index : int array (n,)
        The set of each draw, below J.
    n_sets : int
        J.
    """

    x: FloatArray
    weights: FloatArray
    index: np.ndarray
    n_sets: int

    @property
    def probabilities(self) -> FloatArray:
        """Of each set (J,) under the law."""
        return np.asarray(np.bincount(self.index, self.weights, self.n_sets))

    @property
    def standard_errors(self) -> FloatArray:
        """Of the probabilities (J,), from above: as if the sum of the weights were not known."""
        return np.sqrt(np.bincount(self.index, self.weights**2, self.n_sets))

    def under(self, ratios: FloatArray) -> FloatArray:
        """Probabilities (M, J) under M other laws, given their densities over this one's (n, M)."""
        columns = (ratios * self.weights[:, None]).T
        return np.stack([np.bincount(self.index, c, self.n_sets) for c in columns])


@dataclass(frozen=True, eq=False)
class Search:
    """Rare sets, and where to look for them first.

    Parameters
    ----------
    sets : callable
        Rows (n, d) to the index (n,) of the set each lies in; `n_sets` for none.
    n_sets : int
    start, wide : Density
        `wide` reaches beyond any law.
    """

    sets: Sets
    n_sets: int
    start: Density
    wide: Density


def rare_draws(law: Law, search: Search, rng: np.random.Generator) -> Draws:
    """Weighted draws of the law inside each of the sets.

    Cross-entropy (Rubinstein & Kroese 2004): a mixture is fitted to the weighted draws that met the
    sets, each set with an equal say however rare it is, and drawn from in turn. The last draw
    answers; its weights know nothing of itself.
    """
    proposal = Blend(FIRST_SHARES, (search.start, law, search.wide))
    for _ in range(N_STEPS):
        found = _met(law, search, proposal, N_DRAWS, rng)
        if len(found.x):
            rows = rng.choice(len(found.x), N_FIT, p=_equal_say(found))
            fitted = fit_gaussians(found.x[rows], N_COMPONENTS, rng)
            fitted = replace(fitted, covariances=fitted.covariances * WIDEN)
            proposal = Blend(SHARES, (fitted, law, search.wide))
    return _met(law, search, proposal, N_LAST, rng)


def _met(law: Law, search: Search, proposal: Blend, n: int, rng: np.random.Generator) -> Draws:
    x = proposal.sample(n, rng)
    x = x[law.contains(x)]
    index = search.sets(x)
    x, index = x[index < search.n_sets], index[index < search.n_sets]
    log_f = law.log_density(
        x
    )  # once: the proposal holds the law, an average of forty fits at times
    weights = np.exp(log_f - proposal.log_density(x, (law, log_f))) / n
    there = weights > 0
    return Draws(x[there], weights[there], index[there], search.n_sets)


def _equal_say(draws: Draws) -> FloatArray:
    shares = draws.weights / draws.probabilities[draws.index]
    return np.asarray(shares / shares.sum())
