"""Hits: crashes among the estimating draws where none was implied, and what few of them allow.

Runs that search or learn may lie in a corner that estimating draws hardly reach. A round then is
the surrogate's sum P0 alone, corrected by safe outcomes only: it may be wrong by any factor, and
neither the rounds' scatter nor their predicted variance says so. The count does.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from crashrate.estimation.selection import Drawn
from crashrate.estimation.view import View
from crashrate.variables import FloatArray

ENOUGH = 3  # hits from which on the rounds speak for themselves


@dataclass(frozen=True)
class Hits:
    """Crashes among a round's draws of undecided situations.

    Parameters
    ----------
    n : int
        Crashes, each counted once.
    n_failed : int
        Failed simulations, which may have been crashes.
    reach : float
        Expected hits are at least this times the probability of a crash that nothing implies.
    decided : float
        Probability of what is taken as a crash without a run, P(inner).
    """

    n: int = 0
    n_failed: int = 0
    reach: float = 0.0
    decided: float = 0.0


NONE = Hits()


def count(view: View, drawn: Drawn, outcomes: FloatArray) -> Hits:
    """Hits among `drawn`, whose `outcomes` (n,) were 1, 0, or NaN for a failed simulation."""
    rows = drawn.rows
    there = view.undecided[rows]
    possible = view.undecided & (view.weights > 0)
    least = (drawn.probabilities[possible] / view.weights[possible]).min(initial=np.inf)
    return Hits(
        n=len(np.unique(rows[there & (outcomes == 1)])),
        n_failed=len(np.unique(rows[there & np.isnan(outcomes)])),
        reach=len(rows) * float(least),
        decided=float(view.weights[view.inner].sum()),
    )


def upper_end(found: Sequence[Hits], confidence: float) -> float:
    """Upper end of the probability that so few hits allow; 0 where they are enough.

    Expected hits of a round are Σ pr y n ≥ reach (p - P(inner)); their number is at most as
    variable as Poisson's, whose limit (Garwood 1936) this is, with the P(inner) of the last round,
    the largest. It is wide: a limit on what the draws could have missed, no estimate.
    """
    n = sum(h.n for h in found)
    if n >= ENOUGH:
        return 0.0
    reach = sum(h.reach for h in found)
    possible = n + sum(h.n_failed for h in found)
    most = float(chdtri(2 * (possible + 1), (1 - confidence) / 2)) / 2
    return min(found[-1].decided + most / reach, 1.0) if reach > 0 else 1.0
