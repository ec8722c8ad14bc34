"""Importance sampling's running sums: mean, interval, effective sample size.

Draws x of a proposal q contribute Z = f(x) / q(x) · 1{x crashes}; the mean of Z estimates the
crash probability without bias (2017 paper, §IV.A).
"""

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.special import stdtrit

from crashrate.estimation.encounters import interval
from crashrate.estimation.within_unit import WithinUnit, within_unit
from crashrate.variables import FloatArray


@dataclass(frozen=True)
class Tally:
    """Sums over the contributions Z of all draws so far.

    Parameters
    ----------
    n : int
        Draws.
    total, squares : float
        Σ Z and Σ Z².
    largest : float
        Largest |Z|.
    failed, failed_squares : float
        Σ w and Σ w² of w = f/q over the draws whose simulation failed: what they would add if they
        were crashes.
    n_zero : int
        Draws that contributed nothing.
    """

    n: int = 0
    total: float = 0.0
    squares: float = 0.0
    largest: float = 0.0
    failed: float = 0.0
    failed_squares: float = 0.0
    n_zero: int = 0

    def add(self, z: FloatArray, failed: FloatArray | None = None) -> Self:
        """With more contributions z (n,), zero for a safe or failed draw; weights of the latter."""
        w = np.empty(0) if failed is None else failed
        return type(self)(
            self.n + len(z),
            self.total + float(z.sum()),
            self.squares + float(z @ z),
            max(self.largest, float(abs(z).max(initial=0.0))),
            self.failed + float(w.sum()),
            self.failed_squares + float(w @ w),
            self.n_zero + int(np.count_nonzero(z == 0)),
        )

    @property
    def with_failed(self) -> Self:
        """The same with every failed draw counted as a crash."""
        return replace(
            self,
            total=self.total + self.failed,
            squares=self.squares + self.failed_squares,
            failed=0.0,
            failed_squares=0.0,
        )

    @property
    def mean(self) -> float:
        """The estimate; NaN before the first draw."""
        return self.total / self.n if self.n else math.nan

    @property
    def estimate(self) -> float:
        """The probability nearest to the mean: audits may subtract, and weights exceed 1."""
        return min(max(self.mean, 0.0), 1.0) if self.n else math.nan

    @property
    def standard_error(self) -> float:
        """Of the mean; infinite before the second draw."""
        if self.n < 2:
            return math.inf
        return math.sqrt(max(self.squares / self.n - self.mean**2, 0.0) / (self.n - 1))

    @property
    def n_eff(self) -> float:
        """Number of equally weighted crashes that would be as precise: (Σ Z)² / Σ Z²."""
        return self.total**2 / self.squares if self.squares > 0.0 else 0.0

    @property
    def largest_share(self) -> float:
        """Share of the estimate that hangs on one draw."""
        return self.largest / self.total if self.total > 0.0 else 1.0

    @property
    def log_efficiency(self) -> float:
        """log E[Z²] / log E[Z] (2017 paper, §IV.A): 2 at best, 1 for crude Monte Carlo."""
        if not 0.0 < self.total < self.n:
            return math.nan
        return math.log(self.squares / self.n) / math.log(self.mean)

    def quantile(self, confidence: float) -> float:
        """Half the interval of the mean, in standard errors.

        # differs: Student's quantile with n_eff - 1 degrees of freedom, where the paper takes the
        # normal one: the standard error of a few unequal weights is itself uncertain.
        """
        freedom = max(self.n_eff - 1.0, 1.0)
        return float(stdtrit(freedom, 0.5 + confidence / 2))

    def half_width(self, confidence: float) -> float:
        """Half the interval of the mean."""
        return self.quantile(confidence) * self.standard_error

    def interval(self, confidence: float, largest_weight: float) -> tuple[float, float]:
        """The interval, with every failed simulation counted as safe below and a crash above.

        Without any crash its upper end is the exact one for a share of 0 in n draws, times the
        bound `largest_weight` on f/q; and likewise its lower end where every draw crashed.
        """
        if self.n == 0:
            return 0.0, 1.0
        unseen = largest_weight * interval(0, self.n, confidence)[1]
        safe, crashed = (_plain(tally, confidence) for tally in (self, self.with_failed))
        lower, upper = safe.lower, max(safe.upper, crashed.upper)
        if self.n_zero == 0:
            lower = min(lower, max(1.0 - unseen, 0.0))
        if self.total <= 0.0:
            lower, upper = 0.0, max(upper, min(unseen, 1.0))
        return lower, upper


def _plain(tally: Tally, confidence: float) -> WithinUnit:
    """The interval of the mean alone."""
    return within_unit(tally.mean, tally.half_width(confidence), tally.mean, tally.mean)
