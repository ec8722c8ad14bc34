"""What the simulator has said so far, and what follows from it through the risk order."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np

from crashrate.crash_set.fronts import above_any, below_any, maximal, minimal
from crashrate.crash_set.monotone_set import Label, MonotoneSet
from crashrate.crash_set.order import RiskOrder
from crashrate.estimation.strategy import Problem
from crashrate.variables import BoolArray, FloatArray


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
    """

    order: RiskOrder | None
    x: FloatArray
    u: FloatArray
    y: FloatArray
    learned: MonotoneSet | None = field(repr=False)

    @classmethod
    def empty(cls, problem: Problem) -> Self:
        """Nothing simulated yet."""
        d = problem.traffic.n_variables
        m = d if problem.order is None else problem.order.n_coordinates
        learned = None if problem.order is None else MonotoneSet.empty(m)
        return cls(problem.order, np.empty((0, d)), np.empty((0, m)), np.empty(0), learned)

    def coordinates(self, x: FloatArray) -> FloatArray:
        """Risk coordinates of `x` (n, d): danger grows in each where an order is claimed."""
        return x if self.order is None else self.order(x)

    def add(self, x: FloatArray, y: FloatArray) -> Self:
        """With more outcomes; a failed simulation implies nothing."""
        u, known = self.coordinates(x), ~np.isnan(y)
        learned = self.learned
        if learned is not None:
            learned = learned.add(u[known], y[known] == 1)
        return replace(
            self,
            x=np.concatenate([self.x, x]),
            u=np.concatenate([self.u, u]),
            y=np.concatenate([self.y, y]),
            learned=learned,
        )

    def without_order(self) -> Self:
        """The same outcomes, implying nothing about other situations."""
        return replace(self, learned=None)

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

    def contradiction_depths(self, scale: FloatArray) -> FloatArray:
        """How deep each contradicted outcome is contradicted, in units of `scale` (m,): (k,).

        That is the least of the coordinates' distances to the outcome that contradicts it most. A
        ripple at the edge of the crash set contradicts the order by no more than its own size; an
        order that is wrong contradicts itself as deep as the runs reach.
        """
        if self.learned is None or not self.contradictions:
            return np.empty(0)
        u = self.learned.u[self.learned.contradicted] / scale
        crash = self.learned.crash[self.learned.contradicted]
        gap = (u[~crash][None] - u[crash][:, None]).min(axis=2)  # safe minus crash
        return np.concatenate([gap.max(axis=0), gap.max(axis=1)])

    def presumed(
        self, u: FloatArray, margin: FloatArray | float = 0.0
    ) -> tuple[BoolArray, BoolArray]:
        """The same with contradicted outcomes counted too, where no other says the opposite.

        A set with ripples at its edge contradicts the order there, and nowhere else: giving up all
        that such an outcome implies would cost many runs far from the edge. Not for bounds.

        With a `margin` (m,), only what is that far beyond an outcome in every coordinate.
        """
        crash, safe = np.zeros(len(u), dtype=bool), np.zeros(len(u), dtype=bool)
        if self.learned is not None:
            crash = above_any(u - margin, self._least_crashes)
            safe = below_any(u + margin, self._most_safe)
        return crash & ~safe, safe & ~crash

    @cached_property
    def _least_crashes(self) -> FloatArray:
        return minimal(self.u[self.y == 1])

    @cached_property
    def _most_safe(self) -> FloatArray:
        return maximal(self.u[self.y == 0])

    def implied(self, u: FloatArray) -> tuple[BoolArray, BoolArray]:
        """Which of `u` (n, m) are implied to crash, and which to be safe."""
        if self.learned is None:
            none = np.zeros(len(u), dtype=bool)
            return none, none.copy()
        label = self.learned.classify(u)
        return label == Label.CRASH, label == Label.SAFE
