"""Consequences in the estimating rounds: unbiased whatever was expected, and combined.

A round's draws tell of every consequence z as they do of the event: with m = h g for what was
expected, e = Σ w m + mean(w / pr · (z - m)) has the expectation E[z] given the past, whatever h and
g are. Its variance is predicted by that of z: h (g² + s²) - (h g)².
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import betaincinv

from crashrate.estimation.consequence import MIN_CARRYING, Consequence
from crashrate.estimation.rounds import MIN_INFLATION, Round, combine_all, corrected
from crashrate.estimation.selection import Drawn
from crashrate.estimation.view import Moments, View
from crashrate.variables import FloatArray

# A number that is small in all events seen may be 1 in the next. Sum of it over all runs, and
# effective number of draws with an event times its mean there, below which the draws alone count.
ENOUGH, ENOUGH_DRAWN = 3.0, 1.0


@dataclass(frozen=True)
class Carried:
    """What a round says of one consequence.

    Parameters
    ----------
    round : Round
        Of the consequence in place of the event.
    events, squares, carried : float
        Sums over the runs with the event: of their contributions c = w / pr to its probability,
        of c², and of c z.
    """

    round: Round
    events: float
    squares: float
    carried: float


def carry(view: View, drawn: Drawn, y: FloatArray, z: FloatArray) -> tuple[Carried, ...]:
    """Each consequence in the round in which `drawn` had outcomes y (k,) and z (k, K)."""
    return tuple(
        _carried(view, moments, drawn, y, column)
        for moments, column in zip(view.consequences, z.T, strict=True)
    )


def _carried(view: View, held: Moments, drawn: Drawn, y: FloatArray, z: FloatArray) -> Carried:
    factor = view.weights[drawn.rows] * drawn.factors
    event, spread = factor * (y == 1), view.weights * held.deviation
    return Carried(
        corrected(view, held.mean, np.where(view.failing, 0.0, spread), drawn, z),
        events=float(event.sum()),
        squares=float(event @ event),
        carried=float(event @ np.nan_to_num(z)),
    )


def together(
    name: str,
    found: Sequence[Carried],
    n_carrying: int,
    event: tuple[float, float],
    confidence: float,
    *,
    total: float,
    least: float = MIN_INFLATION,
    aimed: bool,
) -> Consequence:
    """One consequence over the rounds.

    Parameters
    ----------
    name : str
    found : sequence of Carried
        Of the rounds that count for the event.
    n_carrying : int
        Simulator runs that had it.
    event : (float, float)
        Interval for the event's probability.
    confidence : float
        As of `combine`, and `least`.
    total : float
        Sum of it over the runs that had it.
    least : float
    aimed : bool
    """
    c = combine_all([f.round for f in found], confidence, least)
    n_eff = (c.estimate / c.standard_error) ** 2
    low, high = c.lower, c.upper
    share = _share(found, confidence)
    if n_carrying < MIN_CARRYING or total < ENOUGH or share.seen < ENOUGH_DRAWN:
        # what hardly saw it foretells hardly any variance: its word is not taken
        low, high = min(low, event[0] * share.low), max(high, event[1] * share.high)
    return Consequence(
        name=name,
        mean=c.estimate,
        interval=(min(low, event[1]), max(min(high, event[1]), c.estimate)),
        standard_error=c.standard_error,
        n_eff=n_eff,
        n_carrying=n_carrying,
        largest_weight_share=c.largest_share,
        aimed=aimed,
        traffic_range=c.members,
    )


@dataclass(frozen=True)
class _Share:
    """E[z | event] by the draws alone: its interval, and how many events with z = 1 were seen."""

    low: float = 0.0
    high: float = 1.0
    seen: float = 0.0


def _share(found: Sequence[Carried], confidence: float) -> _Share:
    """Interval for E[z | event] from the draws alone: Clopper–Pearson's with unequal weights.

    At the effective numbers of events, and of those with the consequence (Korn & Graubard 1998);
    a number within [0, 1] varies no more than a yes or no of the same mean.
    """
    n = np.array([f.round.n_runs for f in found])
    share = n / n.sum()
    events = float(share @ [f.events for f in found])
    squares = float(share**2 @ [f.squares for f in found])
    if not events > 0:
        return _Share()
    n_eff = events**2 / squares
    seen = n_eff * min(float(share @ [f.carried for f in found]) / events, 1.0)
    tail = (1 - confidence) / 2
    low = float(betaincinv(seen, n_eff - seen + 1, tail)) if seen > 0 else 0.0
    high = float(betaincinv(seen + 1, n_eff - seen, 1 - tail)) if seen < n_eff else 1.0
    return _Share(low, high, seen)
