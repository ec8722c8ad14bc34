"""What a round is worth by what is known now: its variance, reconsidered.

A round predicts its variance by the surrogate that chose its draws. Where that was sure of safety
and wrong, it predicts next to none, and a few rounds without a hit there keep a weight that their
estimates, all too low, do not deserve. With h for what was held then and h' for what is held now,
the draws' variance is Σ w² / pr · (h' (1 - h') + (h' - h)²) / n.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from crashrate.estimation.rounds import TINY, Round, at_least, predicted_variance
from crashrate.estimation.selection import Drawn, IntArray, systematic
from crashrate.estimation.view import View, normalised
from crashrate.variables import BoolArray, FloatArray

N_KEPT = 400  # rows of a round's pool that stand for all of it
N_IN_ALL = 10_000  # of all rounds: where there are many, fewer of each are looked at
# What the rows are drawn by: what the draws were, what was thought hardly likely, and all.
BY_SPREAD, BY_CHANCE, BY_ALL = 0.5, 0.25, 0.25
# A draw where crashes were thought out of the question may move the estimate by a thousand times
# the probability, once in a million rounds: it counts as if it moved it by so many times.
MOST = 10.0


@dataclass(frozen=True, eq=False)
class Design:
    """A round's draws, as they were chosen: some rows of its pool, and what they added up to.

    Parameters
    ----------
    u : ndarray, shape (k, m)
        Risk coordinates.
    weights, h, move : ndarray, shape (k,)
        Weight, what was held, and w / pr / n: what one draw moves the estimate by if it crashes
        (w where it is drawn for sure).
    each : ndarray, shape (k,)
        Rows of the pool that one of these stands for.
    negligible : ndarray of bool, shape (k,)
        Left out of `drawing`, as long as no more is held of it.
    n_pool : int
        Draws of the pool.
    probability, drawing, of_pool : float
        The surrogate's sum over the pool, and the variance that the draws and the pool add to it.
    """

    u: FloatArray
    weights: FloatArray
    h: FloatArray
    move: FloatArray
    each: FloatArray
    negligible: BoolArray
    n_pool: int
    probability: float
    drawing: float
    of_pool: float

    def every(self, step: int) -> Self:
        """With one in `step` rows."""
        kept = {
            k: getattr(self, k)[::step] for k in ("u", "weights", "h", "move", "each", "negligible")
        }
        return replace(self, **kept | {"each": step * kept["each"]})

    def now(self, h: FloatArray) -> tuple[float, float]:
        """Probability and variance of the round if `h` (k,) is held of the rows."""
        w, then = self.weights, self.h
        probability = self._moved(self.probability, w * then, w * h)
        doubt = w * np.minimum(self.move, MOST * probability)
        before, after = doubt * then * (1 - then), doubt * (h * (1 - h) + (h - then) ** 2)
        left_out = np.where(self.negligible, before, 0.0)
        before, after = before - left_out, np.maximum(after - left_out, 0.0)
        drawing = self._moved(self.drawing, before, after)
        mean_square = (probability**2 - self.probability**2) / self.n_pool
        squares = self._moved(self.of_pool, (w * then) ** 2, (w * h) ** 2)
        return probability, drawing + max(squares - mean_square, 0.0)

    def _moved(self, total: float, before: FloatArray, after: FloatArray) -> float:
        """A sum over the pool, once its parts `before` are `after`.

        Some rows tell a share better than a difference, but not a share of next to nothing.
        """
        old, new = float(self.each @ before), float(self.each @ after)
        return total * new / old if new < old else total + new - old


def design(view: View, drawn: Drawn) -> Design:
    """Of the round that drew so."""
    kept, each = _kept(view)
    weights = view.weights[kept]
    return Design(
        u=view.pool.u[kept],
        weights=weights,
        h=view.h[kept],
        move=weights * drawn.mean_squares[kept],
        each=each,
        negligible=view.negligible[kept],
        n_pool=view.pool.n_drawn,
        probability=view.probability,
        drawing=predicted_variance(view, drawn.probabilities, drawn.n),
        of_pool=view.pool_variance,
    )


def _kept(view: View) -> tuple[IntArray, FloatArray]:
    """Rows that stand for the pool, drawn systematically, and how many each of them stands for.

    What is settled is left out: it seldom opens again but at the edge, where it is in doubt anyway.
    """
    rows = np.flatnonzero((view.h > 0) & (view.h < 1) & (view.weights > 0) & ~view.failing)
    if not len(rows):
        return rows, np.empty(0)
    h, w = view.h[rows], view.weights[rows]
    likely = (
        BY_SPREAD * normalised(w * np.sqrt(h * (1 - h)))
        + BY_CHANCE * normalised(w * h**0.25)
        + BY_ALL / len(rows)
    )
    at, times = np.unique(systematic(likely, N_KEPT, 0.5), return_counts=True)
    return rows[at], times / (N_KEPT * likely[at])


def reconsider(
    rounds: Sequence[Round], hold: Callable[[FloatArray], FloatArray]
) -> tuple[Round, ...]:
    """The rounds as known now; `hold` says what is held of risk coordinates (n, m)."""
    step = -(-len(rounds) * N_KEPT // N_IN_ALL)
    designs = [r.design.every(step) for r in rounds if r.design is not None]
    if not designs:
        return tuple(rounds)
    h = hold(np.concatenate([d.u for d in designs]))
    ends = np.cumsum([len(d.u) for d in designs])[:-1]
    found = iter(d.now(part) for d, part in zip(designs, np.split(h, ends), strict=True))
    return tuple(r if r.design is None else _as_known(r.then or r, *next(found)) for r in rounds)


def _as_known(then: Round, probability: float, variance: float) -> Round:
    """The round that was `then`, by what is known now; what else its draws tell likewise.

    Without their own reckoning members and consequences are less sure where the event is, and never
    surer. Where the variance grew, small contributions are no sign that it is small.
    """
    variance = float(at_least(variance, probability))
    by, share = variance / then.variance, probability / max(then.predicted, TINY)
    worse = max(by, 1.0)
    consequences = tuple(
        replace(c, round=_doubted(_scaled(c.round, worse, share), worse)) for c in then.consequences
    )
    found = _doubted(_scaled(then, by, share), worse)
    return replace(found, consequences=consequences, then=then)


def _doubted(r: Round, worse: float) -> Round:
    """With members so much less sure."""
    members = r.members and replace(r.members, variances=worse * r.members.variances)
    return replace(r, members=members)


def _scaled(r: Round, by: float, share: float) -> Round:
    variance = by * r.variance
    squares = max(r.squares, variance) if by > 1 else r.squares
    return replace(r, known=share * r.predicted, variance=variance, squares=squares)
