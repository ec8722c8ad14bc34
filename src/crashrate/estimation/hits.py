"""Hits: crashes among the estimating draws where none was implied, and what few of them allow.

Runs that search or learn may lie in a corner that estimating draws hardly reach. A round then is
the surrogate's sum P0 alone, corrected by safe outcomes only: it may be wrong by any factor, and
neither the rounds' scatter nor their predicted variance says so. The count does.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from crashrate.estimation.selection import Drawn
from crashrate.estimation.view import View
from crashrate.variables import FloatArray


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
        Expected hits are at least this times the probability of a crash that is not `taken`;
        infinite where nothing is undecided.
    taken : float
        Probability of what counts as a crash without a run: P(inner), and where simulations fail.
    """

    n: int = 0
    n_failed: int = 0
    reach: float = 0.0
    taken: float = 0.0


NONE = Hits()


def count(view: View, drawn: Drawn, outcomes: FloatArray) -> Hits:
    """Hits among `drawn`, whose `outcomes` (k,) were 1, 0, or NaN for a failed simulation."""
    rows = drawn.rows
    there = view.undecided[rows]
    possible = view.undecided & (view.weights > 0)
    expected = np.minimum(drawn.n * drawn.probabilities[possible], 1.0)  # each counts once
    least = (expected / view.weights[possible]).min(initial=np.inf)
    return Hits(
        n=int((there & (outcomes == 1)).sum()),
        n_failed=int((there & np.isnan(outcomes)).sum()),
        reach=float(least),
        taken=float(view.weights[view.inner | view.failing].sum()),
    )


def upper_end(found: Sequence[Hits], confidence: float) -> float:
    """Upper end of the probability that so few hits allow.

    Expected hits of a round are Σ pr y n ≥ reach (p - taken), whatever the surrogate holds: of all
    rounds, Σ reach (p - taken) at least. Their number is taken as Poisson's, whose limit this is
    (Garwood 1936). p is the probability under the rounds' pools, with what only the order holds to
    be safe taken as safe. It is wide: a limit on what the draws could have missed, no estimate.
    """
    open_ = [h for h in found if math.isfinite(h.reach)]
    if found and not open_:
        return max(h.taken for h in found)
    reach = sum(h.reach for h in open_)
    if not reach > 0:
        return 1.0
    possible = sum(h.n + h.n_failed for h in open_)
    most = float(chdtri(2 * (possible + 1), (1 - confidence) / 2)) / 2
    return min((most + sum(h.reach * h.taken for h in open_)) / reach, 1.0)
