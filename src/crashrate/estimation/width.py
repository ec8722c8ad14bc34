"""How wide an interval is, in words: ``± 10 %``, or its two sides where they differ."""

import math

MOST_SKEWED = 1.5  # longer side over the shorter: beyond, one number for both would mislead


def is_skewed(estimate: float, interval: tuple[float, float]) -> bool:
    """Whether the interval reaches much farther to one side of its estimate than to the other."""
    below, above = estimate - interval[0], interval[1] - estimate
    return max(below, above) > MOST_SKEWED * min(below, above)


def width_text(estimate: float, interval: tuple[float, float]) -> str:
    """``± 10 %``, ``-71 %, +8 %``; empty where half the interval is more than the estimate.

    Parameters
    ----------
    estimate : float
    interval : (float, float)
        Around it.
    """
    half = (interval[1] - interval[0]) / 2
    if not (estimate > 0 and half <= estimate):
        return ""
    if is_skewed(estimate, interval):
        below, above = (_percent(abs(end / estimate - 1)) for end in interval)
        return f"-{below}, +{above}"
    return f"± {_percent(half / estimate)}"


def _percent(share: float) -> str:
    """As a whole percentage; with one digit that is not 0 where it is less than one."""
    digits = 0 if share == 0 else max(-math.floor(math.log10(100 * share)), 0)
    return f"{100 * share:.{digits}f} %"
