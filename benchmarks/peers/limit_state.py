"""A problem as the reliability methods know it: a limit state in standard normal space, counted."""

import math
from dataclasses import dataclass, replace

import numpy as np

from peers.limits import BudgetError
from problems import Benchmark, Rows
from standard_space import StandardSpace


@dataclass(frozen=True)
class Answer:
    """A probability and its 95 % interval.

    Parameters
    ----------
    probability, low, high : float
    notes : tuple of str
        What happened on the way, in the peer's own figures.
    """

    probability: float
    low: float
    high: float
    notes: tuple[str, ...] = ()

    @classmethod
    def symmetric(cls, probability: float, half_width: float, *notes: str) -> "Answer":
        """With an interval of `half_width` to both sides."""
        return cls(probability, probability - half_width, probability + half_width, notes)

    def scaled(self, factor: float) -> "Answer":
        """The answer times `factor`."""
        return replace(
            self,
            probability=factor * self.probability,
            low=factor * self.low,
            high=factor * self.high,
        )

    def complaint(self) -> str | None:
        """Why this is no estimate, or None where it is one."""
        if not all(map(math.isfinite, (self.probability, self.low, self.high))):
            return f"no finite answer: {self.probability:g} [{self.low:g}, {self.high:g}]"
        return None if self.probability > 0 else "the answer is 0"


class LimitState:
    """Crash where zero or below, as a function of independent standard normals.

    Every row is one call and is counted, those outside the box of a truncated model too: no
    simulator knows the box, and a method that steps out has asked.

    Parameters
    ----------
    problem : Benchmark
    max_calls : int
        A row beyond raises `BudgetError` and is not evaluated.
    binary : bool
        Give -1 for a crash and +1 otherwise in place of the margin.
    """

    def __init__(self, problem: Benchmark, *, max_calls: int, binary: bool = False) -> None:
        if problem.margin is None:
            raise ValueError("limit state: expected a problem with a margin, this one has none.")
        self._margin, self._binary = problem.margin, binary
        self._space = StandardSpace.of(problem.traffic)
        self._lower, self._upper = problem.traffic.lower, problem.traffic.upper
        self._scale = np.sqrt(np.diagonal(problem.traffic.covariance))
        self._max_calls = max_calls
        self.dimension = problem.traffic.n_variables
        self.n_calls = 0
        self.ended: str | None = None

    @property
    def factor(self) -> float:
        """What an estimate of P(limit state ≤ 0) is multiplied by: 1 / P(inside the box)."""
        return 1 / self._space.p_box

    @property
    def n_left(self) -> int:
        """Calls left."""
        return self._max_calls - self.n_calls

    def __call__(self, u: Rows) -> Rows:
        """Standard normal rows (n, d) to limit state values (n,)."""
        u = np.asarray(u, dtype=float).reshape(-1, self.dimension)
        self._check(len(u))
        self.n_calls += len(u)
        x = self._space.to_situations(u)
        inside = np.clip(x, self._lower, self._upper)
        # beyond the box nothing crashes: the distance to it takes over, without a jump in the value
        beyond = (np.abs(x - inside) / self._scale).max(axis=1)
        margin = np.where(
            beyond > 0, np.maximum(self._margin(inside), beyond), self._margin(inside)
        )
        return np.where(margin <= 0, -1.0, 1.0) if self._binary else margin

    def _check(self, n: int) -> None:
        if self.ended or self.n_calls + n > self._max_calls:
            self.ended = f"more than {self._max_calls:,} calls"
            raise BudgetError(self.ended)
