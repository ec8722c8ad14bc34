"""What a round is worth by what is known now: its variance, reconsidered.

A round predicts its variance by the surrogate that chose its draws. Where that was sure of safety
and wrong, it predicts next to none, and a few rounds without a hit there keep a weight that their
estimates, all too low, do not deserve. With h for what was held then and h' for what is held now,
the draws' variance is Σ w² / pr · (h' (1 - h') + (h' - h)²) / n.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from crashrate.estimation.rounds import Round, at_least, predicted_variance
from crashrate.estimation.selection import Drawn
from crashrate.estimation.view import View
from crashrate.variables import FloatArray

N_KEPT = 400  # rows of a round's pool that stand for all of it
# A draw where crashes were thought out of the question may move the estimate by a thousand times
# the probability, once in a million rounds: it counts as if it moved it by so many times.
MOST = 3.0


@dataclass(frozen=True, eq=False)
class Design:
    """A round's draws, as they were chosen: some rows of its pool, and what they added up to.

    Parameters
    ----------
    u : ndarray, shape (k, m)
        Risk coordinates.
    weights, h, move : ndarray, shape (k,)
        Weight, what was held, and w / pr / n: what one draw moves the estimate by if it crashes.
    each : float
        Rows of the pool that one of these stands for.
    n_pool : int
        Draws of the pool.
    probability, drawing, of_pool : float
        The surrogate's sum over the pool, and the variance that the draws and the pool add to it.
    """

    u: FloatArray
    weights: FloatArray
    h: FloatArray
    move: FloatArray
    each: float
    n_pool: int
    probability: float
    drawing: float
    of_pool: float

    def now(self, h: FloatArray) -> tuple[float, float]:
        """Probability and variance of the round if `h` (k,) is held of the rows."""
        w, then = self.weights, self.h
        probability = max(self.probability + self._sum(w * (h - then)), 0.0)
        move = np.minimum(self.move, MOST * probability)
        before = self._sum(w * self.move * then * (1 - then))
        after = self._sum(w * move * (h * (1 - h) + (h - then) ** 2))
        # few rows tell a share better than a difference; but not of next to nothing
        drawing = self.drawing * after / before if after < before else self.drawing + after - before
        squares = self._sum((w * h) ** 2 - (w * then) ** 2)
        mean_squares = (probability**2 - self.probability**2) / self.n_pool
        return probability, drawing + max(self.of_pool + squares - mean_squares, 0.0)

    def _sum(self, parts: FloatArray) -> float:
        return self.each * float(parts.sum())


def design(view: View, drawn: Drawn) -> Design:
    """Of the round that drew so."""
    # what is settled stays so, or all rounds are void
    rows = np.flatnonzero((view.h > 0) & (view.h < 1) & (view.weights > 0) & ~view.failing)
    kept, n = rows[:: max(-(-len(rows) // N_KEPT), 1)], len(drawn.rows)
    weights = view.weights[kept]
    return Design(
        u=view.pool.u[kept],
        weights=weights,
        h=view.h[kept],
        move=weights / np.maximum(drawn.probabilities[kept], 1e-300) / n,
        each=len(rows) / max(len(kept), 1),
        n_pool=view.pool.n_drawn,
        probability=view.probability,
        drawing=predicted_variance(view, drawn.probabilities, n),
        of_pool=view.pool_variance,
    )


def reconsider(
    rounds: Sequence[Round], hold: Callable[[FloatArray], FloatArray]
) -> tuple[Round, ...]:
    """The rounds as known now; `hold` says what is held of risk coordinates (n, m)."""
    designs = [r.design for r in rounds if r.design is not None]
    if not designs:
        return tuple(rounds)
    h = hold(np.concatenate([d.u for d in designs]))
    ends = np.cumsum([len(d.u) for d in designs])[:-1]
    found = iter(d.now(part) for d, part in zip(designs, np.split(h, ends), strict=True))
    return tuple(r if r.design is None else _as_known(r, *next(found)) for r in rounds)


def _as_known(r: Round, probability: float, variance: float) -> Round:
    """The round with that, and all else that its draws tell as much surer or less sure."""
    variance = float(at_least(variance, probability))
    by = variance / r.variance
    members = r.members and replace(r.members, variances=by * r.members.variances)
    consequences = tuple(
        replace(c, round=replace(c.round, variance=by * c.round.variance)) for c in r.consequences
    )
    return replace(
        r, known=probability, variance=variance, members=members, consequences=consequences
    )
