"""What the simulator has said so far, and what follows from it through the risk order."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import maximum_bipartite_matching

from crashrate.crash_set.fronts import above_any, below_any, maximal, minimal
from crashrate.crash_set.monotone_set import Label, MonotoneSet
from crashrate.crash_set.order import RiskOrder
from crashrate.estimation.strategy import Problem
from crashrate.variables import BoolArray, FloatArray

MAX_AGAINST = 2  # outcomes that may contradict one which still counts


@dataclass(frozen=True)
class Labels:
    """Simulated situations with their outcomes.

    Parameters
    ----------
    order : RiskOrder or None
        Gives the coordinates; None takes the variables themselves.
    x, u, y : ndarray, shapes (n, d), (n, m), (n,)
        Situations, their risk coordinates, outcomes: 1 crash, 0 safe, NaN failed.
    learned : MonotoneSet or None
        What the order implies; None where no order is claimed, or it was dropped.
    z : ndarray, shape (n, K)
        Their consequences, NaN where the simulation failed.
    """

    order: RiskOrder | None
    x: FloatArray
    u: FloatArray
    y: FloatArray
    learned: MonotoneSet | None = field(repr=False)
    z: FloatArray = field(default_factory=lambda: np.empty((0, 0)), repr=False)

    @classmethod
    def empty(cls, problem: Problem) -> Self:
        """Nothing simulated yet."""
        d = problem.traffic.n_variables
        m = d if problem.order is None else problem.order.n_coordinates
        learned = None if problem.order is None else MonotoneSet.empty(m)
        z = np.empty((0, len(problem.consequences)))
        return cls(problem.order, np.empty((0, d)), np.empty((0, m)), np.empty(0), learned, z)

    def coordinates(self, x: FloatArray) -> FloatArray:
        """Risk coordinates of `x` (n, d): danger grows in each where an order is claimed."""
        return x if self.order is None else self.order(x)

    def has_coordinates(self, x: FloatArray) -> BoolArray:
        """Where all risk coordinates are finite: one over a range may not be so on its bound."""
        if self.order is None:
            return np.ones(len(x), dtype=np.bool_)
        columns = [self.order.coordinate(k, x) for k in range(self.order.n_coordinates)]
        return np.asarray(np.isfinite(columns).all(axis=0))

    def add(self, x: FloatArray, outcomes: FloatArray) -> Self:
        """With more outcomes (n,), or outcomes and consequences (n, 1 + K).

        A failed simulation implies nothing.
        """
        table = outcomes if outcomes.ndim == 2 else outcomes[:, None]
        y, z = table[:, 0], table[:, 1:]
        u, known = self.coordinates(x), ~np.isnan(y)
        learned = self.learned
        if learned is not None:
            learned = learned.add(u[known], y[known] == 1)
        return replace(
            self,
            x=np.concatenate([self.x, x]),
            u=np.concatenate([self.u, u]),
            y=np.concatenate([self.y, y]),
            z=np.concatenate([self.z, z]),
            learned=learned,
        )

    def without_order(self) -> Self:
        """The same outcomes, implying nothing about other situations."""
        return replace(self, learned=None)

    def by_variables(self) -> Self:
        """The same outcomes by the variables themselves: an order leaves out what matters."""
        return replace(self, order=None, u=self.x, learned=None)

    @property
    def n(self) -> int:
        """Simulator runs so far."""
        return len(self.y)

    @property
    def known(self) -> BoolArray:
        """Runs that did not fail."""
        return ~np.isnan(self.y)

    @property
    def crashes(self) -> FloatArray:
        """Situations that crashed, shape (k, d)."""
        return np.asarray(self.x[self.y == 1])

    @property
    def contradictions(self) -> int:
        """Outcomes that another outcome contradicts through the order."""
        return 0 if self.learned is None else self.learned.contradictions

    def contradiction_gaps(self, scale: FloatArray) -> FloatArray:
        """How deep crash i and safe outcome j contradict each other, in units of `scale` (m,).

        The least of the coordinates' distances by which the safe one is the more dangerous, shape
        (crashes, safe outcomes) of those contradicted; not positive where the two do not. A ripple
        at the edge of the crash set contradicts the order by no more than its own size; an order
        that is wrong contradicts itself as deep as the runs reach.
        """
        if self.learned is None or not self.contradictions:
            return np.empty((0, 0))
        u = self.learned.u[self.learned.contradicted] / scale
        crash = self.learned.crash[self.learned.contradicted]
        return np.asarray((u[~crash][None] - u[crash][:, None]).min(axis=2))

    def presumed(self, u: FloatArray) -> tuple[BoolArray, BoolArray]:
        """As `implied`, contradicted outcomes counted too where no other says the opposite.

        A set with ripples at its edge contradicts the order there, and nowhere else: giving up all
        that such an outcome implies would cost many runs far from the edge. Not for bounds. An
        outcome that many others contradict is left out: it is the one that is odd.
        """
        least, most = self._fronts
        crash, safe = above_any(u, least), below_any(u, most)
        return crash & ~safe, safe & ~crash

    def exceptions(self, margin: FloatArray) -> tuple[int, int]:
        """Safe outcomes, and all, that lie `margin` (m,) and more above a crash.

        The order implies that none of them is safe: the first over the second is the share of
        holes in the crash set. (A crash that many safe outcomes contradict is itself the odd one.)
        """
        if self.learned is None or not self.contradictions:
            return 0, 0
        tested = above_any(self.u - margin, self._fronts[0]) & self.known
        return int((tested & (self.y == 0)).sum()), int(tested.sum())

    @cached_property
    def _fronts(self) -> tuple[FloatArray, FloatArray]:
        """Minimal crashes and maximal safe outcomes among those that few others contradict."""
        if self.learned is None:
            return self.u[:0], self.u[:0]
        u, crash = self.learned.u, self.learned.crash
        against = np.zeros(len(u), dtype=int)
        where = np.flatnonzero(self.learned.contradicted)
        pairs = self.contradiction_gaps(np.ones(u.shape[1])) >= 0
        against[where[crash[where]]] = pairs.sum(axis=1)
        against[where[~crash[where]]] = pairs.sum(axis=0)
        trusted = against <= MAX_AGAINST
        return minimal(u[crash & trusted]), maximal(u[~crash & trusted])

    def implied(self, u: FloatArray) -> tuple[BoolArray, BoolArray]:
        """Which of `u` (n, m) are implied to crash, and which to be safe."""
        if self.learned is None:
            none = np.zeros(len(u), dtype=bool)
            return none, none.copy()
        label = self.learned.classify(u)
        return label == Label.CRASH, label == Label.SAFE

    def implied_deep(self, u: FloatArray, margin: FloatArray) -> BoolArray:
        """Which of `u` (n, m) lie `margin` (m,) and more beyond an outcome that implies theirs.

        Contradicted outcomes vouch for nothing here: what contradicts them is evidence that the
        next safe outcome above a crash, or crash below a safe one, may be as deep again.
        """
        if self.learned is None:
            return np.zeros(len(u), dtype=bool)
        return self.learned.in_inner(u - margin) | ~self.learned.in_outer(u + margin)


def n_to_discard(contradict: BoolArray) -> int:
    """The least number of outcomes without which none of these pairs (crashes, safe) is left.

    By König's theorem the size of a maximum matching: a single wrong outcome counts once, however
    many it contradicts.
    """
    if not contradict.any():
        return 0
    matched = maximum_bipartite_matching(csr_matrix(contradict), perm_type="column")
    return int(np.count_nonzero(matched >= 0))
