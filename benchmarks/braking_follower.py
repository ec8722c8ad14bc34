"""Problem C's vehicle: a follower that brakes when a lead vehicle cuts in, in closed form."""

import numpy as np
import numpy.typing as npt

Rows = npt.NDArray[np.float64]
Outcomes = npt.NDArray[np.bool_]

# Deceleration the follower commands is K·c + E (c the closing speed), at most ACC; where the time
# to collision falls to a threshold, it brakes up to AEB at JERK.
AEB, JERK, ACC, K, E = 8.0, 16.0, 2.5, 0.4, 0.3


def margin_left(v: Rows, inverse_ttc: Rows, inverse_range: Rows) -> Rows:
    """What is left when the follower hits, or does not hit, a lead vehicle of constant speed.

    Where the brakes trigger: the share of the gap that stopping leaves over, zero or below in a
    crash. Where they do not: 1 and more, by the least reserve of time to collision. (The least gap
    would mislead a method that follows it: emergency braking ends most near misses at walking
    speed, and those are not near a crash.)

    Parameters
    ----------
    v, inverse_ttc, inverse_range : ndarray, shape (n,)
        Speed [m/s], closing speed over range [1/s], 1 / range [1/m] as the lead cuts in.
    """
    gap = 1 / np.maximum(inverse_range, 1e-4)
    closing = inverse_ttc * gap
    threshold = 0.6 + 0.8 * v / (v + 10)  # of the time to collision [s]
    now = gap <= threshold * closing
    # constant deceleration ACC until the closing speed is that at which K c + E = ACC
    slow = (ACC - E) / K
    until_slow = np.maximum(closing - slow, 0.0) / ACC
    b, c = closing - threshold * ACC, gap - threshold * closing
    root = np.sqrt(np.maximum(b * b - 2 * ACC * c, 0.0))
    trigger = np.where((b * b >= 2 * ACC * c) & (b > 0), (b - root) / ACC, np.inf)
    first = ~now & (closing > slow) & (trigger <= until_slow)
    t = np.where(now, 0.0, np.where(first, trigger, until_slow))
    gap, closing = gap - closing * t + ACC * t * t / 2, closing - ACC * t
    # then c' = -(K c + E), until the brakes trigger or the gap opens
    later, gap_later, closing_later = _relaxing(gap, closing, threshold)
    known = now | first
    gap, closing = np.where(known, gap, gap_later), np.where(known, closing, closing_later)
    stopped = 1 - _stopping_distance(np.maximum(closing, 0.0)) / gap
    reserve = 1 + np.log(np.maximum(gap / (threshold * np.maximum(closing, 1e-3)), 1.0))
    return np.asarray(np.where(known | later, stopped, reserve))


def _relaxing(gap: Rows, closing: Rows, threshold: Rows) -> tuple[Outcomes, Rows, Rows]:
    """Whether the brakes trigger while c' = -(K c + E), and gap and closing speed then.

    Where they do not: gap and closing speed when they were nearest to it.
    """

    def at(t: Rows) -> tuple[Rows, Rows]:
        left = np.exp(-K * t)
        return (
            gap - (closing + E / K) * (1 - left) / K + E / K * t,
            (closing + E / K) * left - E / K,
        )

    def reserve(t: Rows) -> Rows:
        gap_then, closing_then = at(t)
        return gap_then - threshold * closing_then

    least = E * threshold / (1 - K * threshold)  # closing speed where gap - threshold c is least
    high = np.log((closing + E / K) / (np.minimum(least, closing) + E / K)) / K
    nearest = high
    triggers, low = reserve(high) < 0, np.zeros_like(high)
    for _ in range(50):
        middle = (low + high) / 2
        past = reserve(middle) < 0
        low, high = np.where(past, low, middle), np.where(past, middle, high)
    return triggers, *at(np.where(triggers, high, nearest))


def _stopping_distance(closing: Rows) -> Rows:
    """Relative distance until the closing speed is zero, braking up to AEB at JERK."""
    start = np.minimum(ACC, K * closing + E)
    t = np.minimum(
        (AEB - start) / JERK, (np.sqrt(start * start + 2 * JERK * closing) - start) / JERK
    )
    left = closing - start * t - JERK * t * t / 2
    return closing * t - start * t * t / 2 - JERK * t**3 / 6 + left * left / (2 * AEB)
