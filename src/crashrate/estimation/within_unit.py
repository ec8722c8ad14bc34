"""An estimate of a probability that left [0, 1], brought back, and its interval with it."""

from dataclasses import dataclass


@dataclass(frozen=True)
class WithinUnit:
    """Lower end ≤ estimate ≤ upper end, all within [0, 1].

    Parameters
    ----------
    estimate, lower, upper : float
    """

    estimate: float
    lower: float
    upper: float


def within_unit(center: float, half_width: float, lowest: float, highest: float) -> WithinUnit:
    """The interval from `lowest` - `half_width` to `highest` + `half_width` around `center`.

    A weighted sum may leave [0, 1]. The nearest probability is nearer to the truth; and as the sum
    is wrong by its distance from there at the least, no half-width is less than that.

    Parameters
    ----------
    center : float
    half_width : float
    lowest, highest : float
        The estimate with every failed simulation safe, and with every one a crash.
    """
    estimate = min(max(center, 0.0), 1.0)
    half_width = max(half_width, abs(center - estimate))
    return WithinUnit(
        estimate,
        max(min(lowest, estimate) - half_width, 0.0),
        min(max(highest, estimate) + half_width, 1.0),
    )
