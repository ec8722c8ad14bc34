"""The gap between P(inner) and P(outer): what the order leaves open, and which runs close it.

A crash decides every situation above it, a safe outcome every one below. Seen through a pool of
draws, the gain of a run is the mass that its outcome would decide.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from crashrate.estimation.exploration import INFLATION, inflated
from crashrate.estimation.labels import Labels
from crashrate.estimation.selection import IntArray
from crashrate.estimation.view import normalised
from crashrate.sampling.gaussians import fit_gaussians
from crashrate.sampling.pool import Blend, Pool
from crashrate.traffic.model import TrafficModel
from crashrate.variables import BoolArray, FloatArray

Held = Callable[[FloatArray], FloatArray]
"""Risk coordinates (n, m) to the probability of a crash there (n,)."""

N_SEEN = 2000  # undecided draws that the surrogate looks at, of each of two kinds
N_CANDIDATES = 1200
HEAVY = 0.2  # of the candidates, by their probability in traffic; the others where h is undecided
N_MASS = 8000  # undecided draws that count what a candidate would decide
MOVED = 0.5  # chance that a variable of a candidate is moved to its bound
# of P(outer) that one run may be expected to leave, in single precision: logarithms stay finite
ALL_BUT = 1e-6
# the next pool: as for estimates, but fitted to the gap alone
N_FIT, N_COMPONENTS, WIDEN = 1000, 24, 1.3
SHARES = (0.8, 0.1, 0.1)


@dataclass(frozen=True)
class Gap:
    """A pool, and what outcomes and order imply of it.

    Parameters
    ----------
    pool : Pool
    crash, safe : ndarray of bool, shape (n,)
        Implied; neither is undecided.
    """

    pool: Pool
    crash: BoolArray
    safe: BoolArray

    @classmethod
    def of(cls, pool: Pool, labels: Labels) -> "Gap":
        """What `labels` leave open of `pool`."""
        return cls(pool, *labels.implied(pool.u))

    @cached_property
    def weights(self) -> FloatArray:
        """f / (n q) of each draw."""
        return self.pool.weights

    @cached_property
    def undecided(self) -> IntArray:
        """Rows whose outcome nothing implies."""
        return np.flatnonzero(~(self.crash | self.safe))

    @property
    def inner(self) -> float:
        """P(inner), by the pool."""
        return float(self.weights[self.crash].sum())

    @property
    def outer(self) -> float:
        """P(outer), by the pool."""
        return float(self.weights[~self.safe].sum())

    def bounds(self) -> tuple[float, float]:
        """P(inner) and P(outer), two standard errors to the safe side."""
        inner, outer = self._error(self.crash), self._error(~self.safe)
        return max(self.inner - 2 * inner, 0.0), min(self.outer + 2 * outer, 1.0)

    def _error(self, member: BoolArray) -> float:
        part = self.weights[member]
        square = float(part @ part) - float(part.sum()) ** 2 / self.pool.n_drawn
        return math.sqrt(max(square, 0.0))


@dataclass(frozen=True)
class Look:
    """Undecided draws that the surrogate looked at.

    Parameters
    ----------
    even, heavy : ndarray of int, shapes (k,), (l,)
        Rows of the pool: as they come, and drawn by their probability in traffic.
    h_even, h_heavy : ndarray, shapes (k,), (l,)
        P(crash | outcomes) there.
    """

    even: IntArray
    heavy: IntArray
    h_even: FloatArray
    h_heavy: FloatArray

    @property
    def doubt(self) -> FloatArray:
        """Distribution over `even`, ∝ √(h (1-h)): near the crash set's edge."""
        return normalised(np.sqrt(self.h_even * (1 - self.h_even)))


def look(gap: Gap, held: Held, rng: np.random.Generator) -> Look:
    """Look at a share of the undecided draws, of which there must be one."""
    even = rng.permutation(gap.undecided)[:N_SEEN]
    heavy = rng.choice(gap.undecided, N_SEEN, p=normalised(gap.weights[gap.undecided]))
    h = held(gap.pool.u[np.concatenate([even, heavy])])
    return Look(even, heavy, h[: len(even)], h[len(even) :])


@dataclass(frozen=True)
class Candidates:
    """Undecided situations that may be simulated: `x` (n, d), `u` (n, m) and `h` (n,)."""

    x: FloatArray
    u: FloatArray
    h: FloatArray

    def where(self, rows: BoolArray) -> "Candidates":
        """Some of them."""
        return Candidates(self.x[rows], self.u[rows], self.h[rows])


def candidates(
    gap: Gap,
    seen: Look,
    traffic: TrafficModel,
    labels: Labels,
    *,
    held: Held,
    rng: np.random.Generator,
) -> Candidates:
    """Undecided draws, and the same with some variables at a bound of the traffic model's box.

    No draw lies on a bound, and below a safe situation beside it a slab would stay undecided, thin
    but for ever: half of what was left of one vehicle's P(outer), most of another's.
    """
    n_heavy = round(HEAVY * N_CANDIDATES)
    among = rng.choice(len(seen.even), N_CANDIDATES - n_heavy, p=seen.doubt)
    by_mass = rng.choice(len(seen.heavy), n_heavy)
    rows = np.concatenate([seen.even[among], seen.heavy[by_mass]])
    h = np.concatenate([seen.h_even[among], seen.h_heavy[by_mass]])
    rows, first = np.unique(rows, return_index=True)
    x, u = gap.pool.x[rows], gap.pool.u[rows]
    moved, u_moved = _moved(x, traffic, labels, rng)
    return Candidates(
        np.concatenate([x, moved]),
        np.concatenate([u, u_moved]),
        np.concatenate([h[first], held(u_moved)]),
    )


def _moved(
    x: FloatArray, traffic: TrafficModel, labels: Labels, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Situations `x` (n, d) with some variables at the nearer bound, where that is undecided."""
    bound = np.where(x - traffic.lower < traffic.upper - x, traffic.lower, traffic.upper)
    there = np.isfinite(bound) & (rng.random(x.shape) < MOVED)
    moved = np.where(there, bound, x)[there.any(axis=1)]
    moved = moved[labels.has_coordinates(moved)]
    u = labels.coordinates(moved)
    crash, safe = labels.implied(u)
    open_ = ~(crash | safe)
    return moved[open_], u[open_]


def closest(gap: Gap, among: Candidates, n: int, rng: np.random.Generator) -> FloatArray:
    """Up to `n` candidates (k, d), each expected to shrink log P(outer) / P(inner) most.

    One after another, what the earlier ones are expected to decide taken off the gap.
    """
    rows = rng.permutation(gap.undecided)[:N_MASS]
    weights = gap.weights[rows]
    left = (weights * (gap.weights[gap.undecided].sum() / weights.sum())).astype(np.float32)
    above, below = _comparable(gap.pool.u[rows], among.u)
    h, inner, outer = among.h.astype(np.float32), gap.inner, gap.outer
    chosen: list[int] = []
    for _ in range(min(n, len(h))):
        up, down = above @ left, below @ left
        gain = _gain(h, up, down, inner, outer)
        gain[chosen] = -1.0
        best = int(gain.argmax())
        chosen.append(best)
        inner += float(h[best] * up[best])
        outer -= float((1 - h[best]) * down[best])
        left = left * (1 - h[best] * above[best]) * (1 - (1 - h[best]) * below[best])
    return np.asarray(among.x[chosen])


def _comparable(u: FloatArray, v: FloatArray) -> tuple[np.ndarray, np.ndarray]:
    """Which of `u` (n, m) lie above, and which below, each of `v` (k, m): (k, n) of 0 and 1."""
    above = np.ones((len(v), len(u)), dtype=np.bool_)
    below = above.copy()
    for j in range(u.shape[1]):
        beyond = u[:, j] >= v[:, j, None]
        above &= beyond
        below &= ~beyond
    return above.astype(np.float32), below.astype(np.float32)


def _gain(
    h: np.ndarray, up: np.ndarray, down: np.ndarray, inner: float, outer: float
) -> FloatArray:
    """What log P(outer) / P(inner) is expected to lose by each candidate (k,)."""
    rise = np.log1p(up / max(inner, ALL_BUT * outer))
    fall = -np.log1p(-np.minimum(down / outer, 1 - ALL_BUT))
    return np.asarray(h * rise + (1 - h) * fall, dtype=np.float64)


def aim_at_gap(gap: Gap, seen: Look, traffic: TrafficModel, rng: np.random.Generator) -> Blend:
    """A proposal fitted to what is undecided, in traffic and near the edge, and to P(inner)."""
    w, h = gap.weights[seen.even], seen.h_even
    parts = [
        rng.choice(seen.even, N_FIT, p=normalised(p)) for p in (w * h, w * np.sqrt(h), h * (1 - h))
    ]
    parts.append(seen.heavy[:N_FIT])
    if gap.crash.any():
        inner = np.flatnonzero(gap.crash)
        parts.append(rng.choice(inner, N_FIT // 2, p=normalised(gap.weights[inner])))
    return fitted(gap.pool.x[np.concatenate(parts)], traffic, rng)


def fitted(x: FloatArray, traffic: TrafficModel, rng: np.random.Generator) -> Blend:
    """A proposal fitted to situations (n, d), with two defensive shares."""
    components = fit_gaussians(x, N_COMPONENTS, rng)
    components = replace(components, covariances=components.covariances * WIDEN)
    return Blend(SHARES, (components, traffic, inflated(traffic, (INFLATION,))))
