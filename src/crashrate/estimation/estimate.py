"""The answer of a campaign: a probability, its interval and the evidence, as one frozen value."""

import math
from dataclasses import asdict, dataclass
from typing import Any

from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.estimation.consequence import Consequence
from crashrate.estimation.order_audit import OrderAudit
from crashrate.estimation.traffic_range import TrafficRange

SCHEMA = "crashrate.result/1"


@dataclass(frozen=True)
class HistoryPoint:
    """The estimate as it stood after `n_calls` simulator runs."""

    n_calls: int
    probability: float
    lower: float
    upper: float
    phase: str


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A crash probability with its interval and the evidence for both.

    Parameters
    ----------
    probability : float
        Of a crash in one encounter; NaN before there is an estimate.
    interval : (float, float)
        Confidence interval for `probability`, at level `confidence`.
    confidence : float
        0.95 unless asked otherwise.
    standard_error : float
        Of `probability`. The interval is Student's with few degrees of freedom, so it is longer
        than a normal one.
    bounds : (float, float)
        P(inner) ≤ p ≤ P(outer): hold if the risk order is exact; (0, 1) without one. Exact at the
        end where the risk coordinates allow it; else drawn, two standard errors to the safe side.
    n_calls, n_crashes, n_failed : int
        Simulator runs, those that crashed, those that failed.
    n_eff : float
        Number of equally weighted crashes that would be as precise.
    largest_weight_share : float
        Share of the estimate that hangs on the most influential simulator run.
    log_efficiency : float
        log E[Z²] / log E[Z] for one run's contribution Z: 2 at best, 1 for crude Monte Carlo.
    alarms : tuple of Alarm
        Named doubts; empty when there are none.
    stop_reason : StopReason
    method : str
    seed : int
    history : tuple of HistoryPoint
        The estimate after every batch.
    traffic_range : TrafficRange or None
        The probability under each member of the traffic model; None where it has none.
    goal : {"probability", "bounds"}
        What the runs were spent on. For "bounds" there is no estimate (`probability` is NaN) and
        no interval (0, 1): the answer is `bounds`, if the risk order holds.
    order_audit : OrderAudit or None
        How much of what the order implies can be wrong; at the end of a campaign for bounds.
    consequences : tuple of Consequence
        Expectations per encounter of the declared consequences, in their order.
    """

    probability: float
    interval: tuple[float, float]
    confidence: float
    standard_error: float
    bounds: tuple[float, float]
    n_calls: int
    n_crashes: int
    n_failed: int
    n_eff: float
    largest_weight_share: float
    log_efficiency: float
    alarms: tuple[Alarm, ...]
    stop_reason: StopReason
    method: str
    seed: int
    history: tuple[HistoryPoint, ...]
    traffic_range: TrafficRange | None = None
    goal: str = "probability"
    order_audit: OrderAudit | None = None
    consequences: tuple[Consequence, ...] = ()

    @property
    def bounds_factor(self) -> float:
        """P(outer) over P(inner); infinite while no crash bounds it from below."""
        return self.bounds[1] / self.bounds[0] if self.bounds[0] > 0 else math.inf

    @property
    def half_width(self) -> float:
        """Half the length of the interval."""
        return (self.interval[1] - self.interval[0]) / 2

    @property
    def relative_half_width(self) -> float:
        """Half the length of the interval over the estimate; infinite where that is 0 or NaN."""
        return self.half_width / self.probability if self.probability > 0 else math.inf

    @property
    def crude_monte_carlo_calls(self) -> float:
        """Crude Monte Carlo runs that give the same half-width (paper, §VI: std of the mean)."""
        if not self.probability > 0 or self.half_width == 0:
            return math.inf
        from scipy.special import ndtri

        z = float(ndtri(0.5 + self.confidence / 2))
        return z**2 * self.probability * (1 - self.probability) / self.half_width**2

    @property
    def acceleration(self) -> float:
        """Crude Monte Carlo runs that each simulator run replaces."""
        return self.crude_monte_carlo_calls / self.n_calls if self.n_calls else math.nan

    def sentence(self, event: str = "crash", per: str = "encounter") -> str:
        """The answer in one sentence."""
        if self.goal == "bounds":
            return f"{self._bracket(event, per)}; {self._runs()}"
        return f"{self._head(event, per)}{self._around()}; {self._runs()}{self._crude()}"

    def _around(self) -> str:
        if self.interval == (0.0, 1.0) and not self.probability > 0:
            return ""  # nothing is known, and no interval says so better
        low, high = self.interval
        interval = f"{100 * self.confidence:g} % Monte Carlo interval [{low:.1e}, {high:.1e}]"
        return f", {interval}{self._relative()}"

    def _runs(self) -> str:
        failed = f", {self.n_failed} of them failed" if self.n_failed else ""
        return f"{self.n_calls} simulator run{'s' if self.n_calls != 1 else ''}{failed}"

    def _bracket(self, event: str, per: str) -> str:
        low, high = self.bounds
        if self.bounds == (0.0, 1.0):
            return f"P({event}) has no bounds: {self._why_unbounded()}"
        factor = f", a factor of {self.bounds_factor:.3g}" if low > 0 else ""
        bracket = f"{low:.1e} ≤ P({event}) ≤ {high:.1e} per {per}"
        return f"bounds if the risk order holds: {bracket}{factor}"

    def _why_unbounded(self) -> str:
        if 0 < self.n_calls == self.n_failed:
            return f"all {self.n_calls} simulations failed"
        if Alarm.ORDER_DROPPED in self.alarms:
            return "the risk order was dropped"
        return "no outcome implies any other yet"

    def _head(self, event: str, per: str) -> str:
        if self.probability > 0:
            return f"P({event}) = {self.probability:.1e} per {per}"
        if 0 < self.n_calls == self.n_failed:
            return f"P({event}) is not determined: all {self.n_calls} simulations failed"
        if self.n_crashes:
            return f"P({event}) has no estimate yet"
        return f"P({event}) is not determined: no {event} was seen"

    def _relative(self) -> str:
        relative = self.relative_half_width
        return f" (± {100 * relative:.0f} %)" if relative <= 1 else ""

    def _crude(self) -> str:
        calls = self.crude_monte_carlo_calls
        if not 1 <= calls < math.inf:
            return ""
        return f"; crude Monte Carlo would need {in_words(calls)}"

    def to_dict(self, per: str = "encounter") -> dict[str, Any]:
        """The estimate as JSON-ready values; numbers that are not finite become None.

        `per` names what the consequences' sentences count.
        """
        record = asdict(self) | {
            "schema": SCHEMA,
            "relative_half_width": self.relative_half_width,
            "crude_monte_carlo_calls": self.crude_monte_carlo_calls,
            "acceleration": self.acceleration,
            "alarms": [{"name": a.name, "message": a.value} for a in self.alarms],
            "stop_reason": self.stop_reason.value,
            "traffic_range": self.traffic_range and self.traffic_range.to_dict(),
            "bounds_factor": self.bounds_factor,
            "order_audit": self.order_audit and self.order_audit.to_dict(self.bounds),
            "consequences": [c.to_dict(per) for c in self.consequences],
        }
        return {key: json_ready(value) for key, value in record.items()}


def in_words(number: float) -> str:
    """A large count with two significant digits: ``190 million``, ``43,000``."""
    for size, word in ((1e12, "trillion"), (1e9, "billion"), (1e6, "million")):
        if number >= size:
            return f"{_two_digits(number / size):,g} {word}"
    return f"{_two_digits(number):,.0f}"


def _two_digits(number: float) -> float:
    return float(f"{number:.2g}")


def json_ready(value: Any) -> Any:
    """`value` with None for numbers that are not finite, which JSON has not."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: json_ready(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [json_ready(v) for v in value]
    return value
