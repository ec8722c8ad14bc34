"""Which draws of a pool to simulate: to learn the crash set, and to estimate without bias."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from crashrate.estimation.view import View, normalised
from crashrate.variables import FloatArray

N_CANDIDATES = 1200
MIN_SETTLED = 0.03  # a greedy run must be expected to settle this share of the doubt
# Shares of the estimating draws: by what a run can tell, by undecided crash mass, by undecided
# mass, and an audit of what the order implies.
SPREAD, UNDECIDED_CRASH, UNDECIDED, AUDIT = 0.85, 0.05, 0.05, 0.05
DIRECTED = 0.75  # of a directed round's draws: its own estimate costs four times the variance

IntArray = npt.NDArray[np.intp]


def greedy(view: View, n: int, rng: np.random.Generator) -> IntArray:
    """Up to `n` draws, each expected to settle most of the remaining doubt through the order.

    A crash settles everything above it, a safe outcome everything below.
    """
    if n == 0 or not view.spread.sum() > 0:
        return np.empty(0, dtype=int)
    rows = np.unique(rng.choice(len(view.h), N_CANDIDATES, p=normalised(view.spread)))
    u, h = view.pool.u[rows], view.h[rows]
    above = np.all(u[:, None] >= u[None], axis=2).astype(np.float32)
    doubt, chosen = np.ones(len(rows)), []
    for _ in range(n):
        settled = (1 - h) * (above @ doubt) + h * (above.T @ doubt)
        best = int(settled.argmax())
        if settled[best] < MIN_SETTLED * doubt.sum() or not doubt.sum() > 0:
            break
        chosen.append(rows[best])
        doubt = doubt * (1 - (above[best] if h[best] < 0.5 else above[:, best]))
    return np.array(chosen, dtype=int)


def aside(view: View, n: int, audits: IntArray, rng: np.random.Generator) -> IntArray:
    """`n` draws or fewer that no estimate is made of: `audits` of the order, and greedy ones."""
    audits = audits[:n]
    return np.unique(np.concatenate([audits, greedy(view, n - len(audits), rng)]))


def audit(view: View, n: int, rng: np.random.Generator) -> IntArray:
    """Up to `n` draws of what the order implies to crash, as likely as they are in traffic.

    Whether a crash set has holes is seen nowhere else: all other runs keep to its edge.
    """
    implied = view.weights * view.inner
    if n == 0 or not implied.sum() > 0:
        return np.empty(0, dtype=int)
    return np.unique(rng.choice(len(implied), n, p=normalised(implied)))


def to_learn(view: View, n: int, audits: IntArray, rng: np.random.Generator) -> IntArray:
    """`n` draws that teach most about the crash set: half by dominance or audits, half by doubt."""
    first = aside(view, n // 2 if view.ordered else 0, audits, rng)
    rest = rng.choice(len(view.h), n - len(first), p=view.learning)
    return np.unique(np.concatenate([first, rest]).astype(int))


@dataclass(frozen=True)
class Drawn:
    """Draws to estimate from.

    Parameters
    ----------
    rows : ndarray of int, shape (k,)
        In the pool, each once: a run for each.
    times : ndarray of int, shape (k,)
        How often each was drawn.
    probabilities : ndarray, shape (N,)
        Of each pool row in one draw.
    """

    rows: IntArray
    times: IntArray
    probabilities: FloatArray

    @property
    def n(self) -> int:
        """Draws, repetitions included."""
        return int(self.times.sum())

    @property
    def factors(self) -> FloatArray:
        """What each run stands for, (k,): with it a sum over the runs is one over the pool."""
        return np.asarray(self.times / (self.n * self.probabilities[self.rows]))

    @property
    def mean_squares(self) -> FloatArray:
        """Of the factors, zero where it is not drawn, at each row of the pool, (N,)."""
        return mean_squares(self.n * self.probabilities)


def mean_squares(expected: FloatArray) -> FloatArray:
    """Mean square of times drawn over times `expected`, if the draws are systematic.

    1 / m below one. A row that is expected m times is drawn as often as m's next integers: beyond
    one it is drawn for sure, and its outcome counts in full, however often it is.
    """
    m = np.maximum(expected, 1e-300)
    beyond = m - np.floor(m)
    return np.where(m < 1, 1 / m, 1 + beyond * (1 - beyond) / np.maximum(m, 1.0) ** 2)


def to_estimate(view: View, n: int, rng: np.random.Generator, towards: View | None = None) -> Drawn:
    """`n` draws with known probabilities, systematic along h so that they spread over it.

    Where the round is directed `towards` other traffic, most are drawn for that; the rest keep
    every draw possible that `view` would make, and its estimate of use.
    """
    probabilities = estimating(view)
    if towards is not None:
        probabilities = DIRECTED * estimating(towards) + (1 - DIRECTED) * probabilities
    by_h = np.argsort(view.h, kind="stable")
    chosen = systematic(probabilities[by_h], n, rng.random())
    places, times = np.unique(chosen, return_counts=True)
    return Drawn(by_h[places], times, probabilities)


def systematic(likely: FloatArray, n: int, start: float) -> IntArray:
    """`n` rows at equal steps of the sum of `likely` (N,), from the share `start` of a step on."""
    edges = np.cumsum(likely)
    ticks = (start + np.arange(n)) / n * edges[-1]
    return np.asarray(np.minimum(np.searchsorted(edges, ticks), len(likely) - 1))


def estimating(view: View) -> FloatArray:
    """Probability (N,) of each draw of the pool in one draw to estimate from."""
    spread = normalised(view.aimed_spread)
    # without an order all is undecided, nearly all of it ordinary traffic: half goes elsewhere
    undecided = view.weights * view.undecided
    if not view.ordered:
        undecided = normalised(undecided) + normalised(view.alike * view.undecided)
    likely = np.where(view.inner, 1.0, view.surrogate_h)
    parts = (
        (SPREAD, view.drawing),
        (UNDECIDED_CRASH, view.weights * view.h * view.undecided),
        (UNDECIDED, undecided),
        (AUDIT, np.where(view.inner | view.safe, view.weights * likely, 0.0)),
    )
    mixed = sum(s * (normalised(p) if p.sum() > 0 else spread) for s, p in parts)
    return normalised(np.asarray(mixed))
