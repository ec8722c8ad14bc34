"""The seam between a campaign and its methods.

A method is a generator: it yields a `Query` (situations to simulate, and what it knows so far),
receives the outcomes of those situations, and returns its last `Snapshot`. All its state is local,
so that a campaign is a function of (configuration, seed, outcomes) and resume is replay.
"""

import math
from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from functools import cached_property
from numbers import Integral, Real
from typing import TYPE_CHECKING

import numpy as np

from crashrate.crash_set.blind import Blind
from crashrate.crash_set.monotone_set import MonotoneSet
from crashrate.crash_set.order import RiskOrder
from crashrate.errors import InvalidInputError
from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.estimation.consequence import Consequence
from crashrate.estimation.traffic_range import TrafficRange
from crashrate.traffic.model import TrafficModel
from crashrate.variables import FloatArray

if TYPE_CHECKING:
    from crashrate.estimation.belief import Belief
    from crashrate.estimation.order_audit import OrderAudit

HALF_WIDTH = "a number above 0 and up to 1 (0.1 means ± 10 %)"
NUMBERS = {
    "relative_half_width": Real,
    "max_calls": Integral,
    "confidence": Real,
    "batch_size": Integral,
    "seed": Integral,
}


@dataclass(frozen=True, kw_only=True)
class Problem:
    """What is asked: a traffic model, a risk order, a target and a budget.

    Parameters
    ----------
    traffic : TrafficModel
        How often each situation occurs.
    order : RiskOrder or None
        Which way is riskier; None claims no monotonicity.
    relative_half_width : float
        Target: half the interval over the estimate.
    max_calls : int
        Budget of simulator runs.
    confidence : float
        Level of the interval.
    batch_size : int
        Simulator runs asked for at a time.
    ensemble : TrafficModel or None
        The model with members whose average `traffic` is.
    seed : int
        Batch k draws from ``SeedSequence(seed, spawn_key=(k,))``.
    earlier_targets : tuple of (float, int)
        Half-widths that were aimed at before, each until so many simulator runs: what a campaign
        asks for next may depend on whether its target is met.
    earlier_budgets : tuple of (int, int)
        Budgets that were in force before, each until so many simulator runs: what a campaign for
        bounds asks for last depends on where its budget ends.
    consequences : tuple of str
        Names of the numbers in [0, 1] that a run also tells, 0 where the event did not happen.
    aim : str or None
        The consequence whose expectation the target is for; None for the event itself.
    """

    traffic: TrafficModel
    order: RiskOrder | None = None
    relative_half_width: float = 0.1
    max_calls: int = 2000
    confidence: float = 0.95
    batch_size: int = 10
    seed: int = 0
    ensemble: TrafficModel | None = None
    earlier_targets: tuple[tuple[float, int], ...] = ()
    earlier_budgets: tuple[tuple[int, int], ...] = ()
    consequences: tuple[str, ...] = ()
    aim: str | None = None

    def __post_init__(self) -> None:
        for name, kind in NUMBERS.items():
            if not isinstance(value := getattr(self, name), kind) or isinstance(value, bool):
                expected = "an integer" if kind is Integral else "a number"
                raise InvalidInputError(f"{name}: expected {expected}, got {value!r}.")
        checks = (
            (0 < self.relative_half_width <= 1, "relative_half_width", HALF_WIDTH),
            (self.max_calls >= 1, "max_calls", "at least 1"),
            (0 < self.confidence < 1, "confidence", "a number between 0 and 1"),
            (self.batch_size >= 1, "batch_size", "at least 1"),
            (self.seed >= 0, "seed", "a non-negative integer"),
        )
        for holds, name, expected in checks:
            if not holds:
                raise InvalidInputError(f"{name}: expected {expected}, got {getattr(self, name)}.")

    @property
    def aim_index(self) -> int | None:
        """Place of `aim` among the consequences."""
        return None if self.aim is None else self.consequences.index(self.aim)

    @cached_property
    def blind(self) -> Blind | None:
        """Directions that the order does not see, and claims not to matter; None without any."""
        found = None if self.order is None else Blind.of(self.order, self.traffic)
        return found if found is not None and found.n else None

    def target_at(self, n_calls: int) -> float:
        """The relative half-width that is aimed at after so many simulator runs."""
        earlier = (target for target, until in self.earlier_targets if n_calls < until)
        return next(earlier, self.relative_half_width)

    def budget_at(self, n_calls: int) -> int:
        """The budget that is in force after so many simulator runs."""
        earlier = (budget for budget, until in self.earlier_budgets if n_calls < until)
        return next(earlier, self.max_calls)

    def rng(self, k: int) -> np.random.Generator:
        """The generator of batch `k`, independent of all others and of what was drawn before."""
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(k,)))


@dataclass(frozen=True, kw_only=True)
class Snapshot:
    """What a method knows at one moment.

    Parameters
    ----------
    probability : float
        The estimate, NaN before there is one.
    interval : (float, float)
        At the problem's confidence; (0, 1) before there is an estimate.
    standard_error : float
        Of `probability`.
    bounds : (float, float)
        P(inner) and P(outer), valid if the risk order is exact; (0, 1) without an order.
    n_eff : float
        Effective sample size: the number of equally weighted crashes that would be as precise.
    largest_weight_share : float
        Share of the estimate that hangs on the single most influential simulator run.
    log_efficiency : float
        log E[Z²] / log E[Z] of one run's contribution Z: 2 at best, 1 for crude Monte Carlo.
    alarms : tuple of Alarm
    traffic_range : TrafficRange or None
        The probability under each member of the traffic model.
    consequences : tuple of Consequence
        Expectations of the event's consequences; empty before there is an estimate.
    order_audit : OrderAudit or None
        What random runs said of the outcomes that the order implies: at the end of a campaign for
        bounds.
    learned : MonotoneSet or None
        What the outcomes imply through the risk order.
    belief : Belief or None
        The crash probability of any situation, as learned: at the end of a campaign that found
        crashes by a method with a surrogate.
    phase : str
        For progress display.
    stop_reason : StopReason
    """

    probability: float = float("nan")
    interval: tuple[float, float] = (0.0, 1.0)
    standard_error: float = float("inf")
    bounds: tuple[float, float] = (0.0, 1.0)
    n_eff: float = 0.0
    largest_weight_share: float = 1.0
    log_efficiency: float = float("nan")
    alarms: tuple[Alarm, ...] = ()
    traffic_range: TrafficRange | None = None
    consequences: tuple[Consequence, ...] = ()
    order_audit: "OrderAudit | None" = None
    learned: MonotoneSet | None = field(default=None, repr=False)
    belief: "Belief | None" = field(default=None, repr=False)
    phase: str = "explore"
    stop_reason: StopReason = StopReason.RUNNING


@dataclass(frozen=True)
class Query:
    """Situations to simulate, `x` of shape (n, d), and what is known before their outcomes."""

    x: FloatArray
    snapshot: Snapshot


Method = Callable[[Problem], Generator[Query, FloatArray, Snapshot]]


def unknown(problem: Problem, s: Snapshot, z: FloatArray) -> tuple[Consequence, ...]:
    """The consequences z (n, K) without an estimate: at most the event's upper end."""
    return tuple(
        Consequence(
            name=name,
            mean=0.0 if s.probability == 0 else math.nan,
            interval=(0.0, s.interval[1]),
            standard_error=math.inf,
            n_eff=0.0,
            n_carrying=int(np.count_nonzero(column > 0)),
            largest_weight_share=1.0,
            aimed=name == problem.aim,
        )
        for name, column in zip(problem.consequences, z.T, strict=True)
    )
