"""What an event leads to in one encounter: the expectation of a consequence, as a frozen value."""

import math
from dataclasses import dataclass

from crashrate.estimation.alarms import SHARE_LIMIT
from crashrate.estimation.traffic_range import TrafficRange
from crashrate.estimation.width import width_text

MIN_N_EFF = 5.0  # below it, the runs do not determine a consequence
MIN_CARRYING = 10  # nor if fewer runs had it
ROUGH = 0.5  # an interval of more to either side is no more than a first idea …
WIDEST_TARGET = 1.0  # … but for what a target asked for, which is no wider than this


@dataclass(frozen=True, kw_only=True)
class Consequence:
    """The expectation of a number in [0, 1] that is 0 where the event does not happen.

    Parameters
    ----------
    name : str
    mean : float
        Per encounter, not per event; NaN before there is an estimate.
    interval : (float, float)
        Confidence interval for `mean`, at the estimate's level.
    standard_error : float
        Of `mean`.
    n_eff : float
        (mean / standard error)²: the number of equally weighted events that would be as precise,
        had all of them the consequence in full.
    n_carrying : int
        Simulator runs that had it at all.
    largest_weight_share : float
        Share of `mean` that hangs on the most influential simulator run.
    aimed : bool
        Whether the campaign's target was for this number.
    traffic_range : TrafficRange or None
        The expectation under each of the traffic model's members; None where it has none.
    """

    name: str
    mean: float
    interval: tuple[float, float]
    standard_error: float
    n_eff: float
    n_carrying: int
    largest_weight_share: float
    aimed: bool = False
    traffic_range: TrafficRange | None = None

    @property
    def half_width(self) -> float:
        """Half the length of the interval."""
        return (self.interval[1] - self.interval[0]) / 2

    @property
    def relative_half_width(self) -> float:
        """Half the length of the interval over the mean; infinite where that is 0 or NaN."""
        return self.half_width / self.mean if self.mean > 0 else math.inf

    @property
    def determined(self) -> bool:
        """Whether enough runs had it for the interval to rest on them."""
        return self.n_eff >= MIN_N_EFF and self.n_carrying >= MIN_CARRYING

    @property
    def rough(self) -> bool:
        """Whether more should be known of it before it is used, but for what a target asked for."""
        concentrated = self.largest_weight_share > SHARE_LIMIT
        wide = self.relative_half_width > (WIDEST_TARGET if self.aimed else ROUGH)
        return not self.determined or concentrated or wide

    def sentence(self, per: str = "encounter") -> str:
        """The answer in one sentence."""
        low, high = self.interval
        if not self.determined:
            seen = f"{self.n_carrying} simulator run{'s' * (self.n_carrying != 1)} had it"
            bracket = f"≤ {high:.1e}" if low == 0 else f"between {low:.1e} and {high:.1e}"
            return f"E({self.name}) {bracket} per {per}: not determined, {seen}"
        width = width_text(self.mean, self.interval)
        about = width and f" ({width})"
        rough = ": a first idea only" if self.rough else ""
        return f"E({self.name}) = {self.mean:.1e} per {per}, [{low:.1e}, {high:.1e}]{about}{rough}"

    def to_dict(self, per: str = "encounter") -> dict[str, object]:
        """As JSON-ready values, but for numbers that are not finite."""
        return vars(self) | {
            "interval": list(self.interval),
            "relative_half_width": self.relative_half_width,
            "determined": self.determined,
            "sentence": self.sentence(per),
            "traffic_range": self.traffic_range and self.traffic_range.to_dict(self.name),
        }
