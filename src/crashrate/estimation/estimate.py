"""The answer of a campaign: a probability, its interval and the evidence, as one frozen value."""

import math
from dataclasses import asdict, dataclass
from typing import Any

from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.estimation.consequence import Consequence
from crashrate.estimation.order_audit import OrderAudit
from crashrate.estimation.suspect import Suspect
from crashrate.estimation.traffic_range import TrafficRange
from crashrate.estimation.width import is_skewed, width_text

SCHEMA = "crashrate.result/1"
PURPOSES = {  # of the phases before an estimate
    "explore": "finding crashes",
    "learn": "learning where they begin",
    "adapt": "adapting the proposal",
}
WIDE = 0.25  # half of an interval that says little of any probability
NEAR_ONE = 0.99  # an estimate above it is said by its distance to 1


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
    order_suspect : Suspect or None
        The declared direction to look at first, where outcomes contradict the order and reversing
        one direction would leave few of them against it.
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
    order_suspect: Suspect | None = None
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
    def determined(self) -> bool:
        """Whether the estimate says more than its interval.

        Half of that is at most the estimate, and the whole at most half of [0, 1]. Else the
        interval alone is the answer, and the estimate a first idea. (So it is before the first
        crash, where the interval has an upper end alone.)
        """
        return self.relative_half_width <= 1 and self.half_width <= WIDE

    @property
    def crude_monte_carlo_calls(self) -> float:
        """Crude Monte Carlo runs that give the same half-width (paper, §VI: std of the mean).

        NaN where there is nothing to compare: an interval that is no normal one, because it is
        wider than its estimate to either side, or reaches much farther to one of them (failed
        runs, say); or an estimate so near to 1 that the formula asks for no run.
        """
        if not 0 < self.relative_half_width <= 1 or is_skewed(self.probability, self.interval):
            return math.nan
        from scipy.special import ndtri

        z = float(ndtri(0.5 + self.confidence / 2))
        calls = z**2 * self.probability * (1 - self.probability) / self.half_width**2
        return calls if calls >= 1 else math.nan

    @property
    def acceleration(self) -> float:
        """Crude Monte Carlo runs that each simulator run replaces."""
        return self.crude_monte_carlo_calls / self.n_calls if self.n_calls else math.nan

    def sentence(self, event: str = "crash", per: str = "encounter") -> str:
        """The answer in one sentence."""
        if self.goal == "bounds":
            return f"{self._bracket(event, per)}; {self._runs()}"
        return f"{self._head(event, per)}{self._around()}; {self._runs()}{self._crude()}"

    def _went_into(self) -> str:
        """What the runs of a method that has no estimate yet were for."""
        phase = self.history[-1].phase.split()[0] if self.history else ""
        return f": the runs went into {PURPOSES[phase]}" if phase in PURPOSES else ""

    def _around(self) -> str:
        if self.interval == (0.0, 1.0) and not self.determined:
            return ""  # nothing is known, and no interval says so better
        low, high = (_number(end, self.probability) for end in self.interval)
        interval = f"{100 * self.confidence:g} % Monte Carlo interval [{low}, {high}]"
        return f", {interval}{self._relative()}"

    def _runs(self) -> str:
        text = f"{self.n_calls:,} simulator run{'s' if self.n_calls != 1 else ''}"
        if self.n_crashes and not self.determined and self.goal == "probability":
            text += f", {self.n_crashes:,} of them crashed"
        if 0 < self.n_failed < self.n_calls:
            text += f", {self.n_failed:,} of them failed"
        return text

    def _bracket(self, event: str, per: str) -> str:
        low, high = self.bounds
        if self.bounds == (0.0, 1.0):
            return f"P({event}) has no bounds: {self._why_unbounded()}"
        factor = f", a factor of {self.bounds_factor:.3g}" if low > 0 else ""
        bracket = f"{low:.1e} ≤ P({event}) ≤ {high:.1e} per {per}"
        return f"bounds if the risk order holds: {bracket}{factor}"

    def _why_unbounded(self) -> str:
        if 0 < self.n_calls == self.n_failed:
            return f"all {self.n_calls:,} simulations failed"
        if Alarm.ORDER_DROPPED in self.alarms:
            return "the risk order was dropped"
        return "no outcome implies any other yet"

    def _head(self, event: str, per: str) -> str:
        if self.determined:
            return f"P({event}) = {_number(self.probability, self.probability)} per {per}"
        if self.probability > 0:
            return f"P({event}) is not determined: {self.probability:.1e} per {per} so far"
        if 0 < self.n_calls == self.n_failed:
            return f"P({event}) is not determined: all {self.n_calls:,} simulations failed"
        if self.n_crashes:
            return f"P({event}) has no estimate yet{self._went_into()}"
        return f"P({event}) is not determined: no {event} was seen"

    def _relative(self) -> str:
        if self.probability > NEAR_ONE:  # where the distance to 1 is what is uncertain
            return ""
        text = width_text(self.probability, self.interval)
        return text and f" ({text})"

    def _crude(self) -> str:
        calls = self.crude_monte_carlo_calls
        return "" if math.isnan(calls) else f"; crude Monte Carlo would need {in_words(calls)}"

    def to_dict(self, per: str = "encounter") -> dict[str, Any]:
        """The estimate as JSON-ready values; numbers that are not finite become None.

        `per` names what the consequences' sentences count.
        """
        record = asdict(self) | {
            "schema": SCHEMA,
            "determined": self.determined,
            "relative_half_width": self.relative_half_width,
            "crude_monte_carlo_calls": self.crude_monte_carlo_calls,
            "acceleration": self.acceleration,
            "alarms": [{"name": a.name, "message": a.value} for a in self.alarms],
            "stop_reason": self.stop_reason.value,
            "traffic_range": self.traffic_range and self.traffic_range.to_dict(),
            "bounds_factor": self.bounds_factor,
            "order_audit": self.order_audit and self.order_audit.to_dict(self.bounds),
            "order_suspect": self.order_suspect and self.order_suspect.to_dict(),
            "consequences": [c.to_dict(per) for c in self.consequences],
        }
        return {key: json_ready(value) for key, value in record.items()}


def _number(value: float, probability: float) -> str:
    """A probability beside the estimate, to two digits: of its distance to 1 where that is near."""
    if not probability > NEAR_ONE:
        return f"{value:.1e}"
    return "1" if value == 1 else f"1 - {1 - value:.1e}"


def in_words(number: float) -> str:
    """A large count with two significant digits: ``190 million``, ``43,000``, ``4.0e+20``."""
    if number >= 1e15:
        return f"{number:.1e}"
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
