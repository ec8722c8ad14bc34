"""The method "crude": random encounters, until so many have crashed or the budget ends.

To look at the interval after every batch and to stop once it is narrow would bias both the estimate
and the interval. Here the number of crashes at which to stop follows from the target alone, not
from how many encounters they took: inverse binomial sampling (Haldane 1945). With K crashes among
N encounters, the last of them a crash by design,

- (K - 1) / (N - 1) is unbiased; so is the share of crashes where the budget ends first, and so is
  the procedure as a whole (Girshick, Mosteller, Savage 1946);
- the number of encounters that K crashes take exceeds n where fewer than K of n crash: the ends of
  the Clopper–Pearson interval, the upper one without the last encounter, stay exact.

The risk order is not used: nothing but the outcomes themselves is believed.

References
----------
J. B. S. Haldane, "On a method of estimating frequencies", Biometrika 33 (1945). M. A. Girshick,
F. Mosteller, L. J. Savage, "Unbiased estimates for certain binomial sampling problems with
applications", Annals of Mathematical Statistics 17 (1946).
"""

import math
from collections.abc import Generator
from dataclasses import replace

import numpy as np
from scipy.special import gammaincinv

from crashrate.estimation.alarms import SHARE_LIMIT, Alarm, StopReason
from crashrate.estimation.crude import CRUDE, PHASE, encounter
from crashrate.estimation.encounters import Encounters
from crashrate.estimation.strategy import Problem, Query, Snapshot
from crashrate.variables import FloatArray


def crude_monte_carlo(problem: Problem) -> Generator[Query, FloatArray, Snapshot]:
    """Simulate random encounters; see the module.

    What the last batch holds after the crash at which it stops is left out of the estimate.
    """
    rng, seen, n_calls = problem.rng(CRUDE), Encounters(), 0
    while n_calls < problem.max_calls:
        x = encounter(problem, rng, n_calls)
        y = yield Query(x, _snapshot(seen, seen.interval(problem.confidence)))
        n_calls += len(x)
        until = _first_enough(seen, y, problem.target_at(n_calls), problem.confidence)
        if until is not None:
            return _stopped(problem, seen + Encounters.of(y[:until]))
        seen += Encounters.of(y)
    return _ended(problem, seen)


def enough(seen: Encounters, target: float, confidence: float) -> bool:
    """Whether the crashes suffice for `target`, however many encounters they took.

    The interval of a rare probability, where K crashes take a Gamma(K) time: a common one has a
    narrower interval. Of a failed run it is only known that it may be a crash.
    """
    k, n_failed, tail = seen.n_crashes, seen.n_failed, (1 - confidence) / 2
    if k < 2:
        return False
    low, high = gammaincinv(k, tail), gammaincinv(k + n_failed, 1 - tail)
    return bool((high - low) / 2 <= target * (k - 1))


def inverse_interval(seen: Encounters, confidence: float) -> tuple[float, float]:
    """The interval where the last of `seen` is a crash by design; failed runs as ever.

    Conditional on which of the runs that do not end safely are failures, those at which it stops
    are a fixed number: the upper end stays exact however many failed.
    """
    return seen.interval(confidence)[0], _but_last(seen).interval(confidence)[1]


def _but_last(seen: Encounters) -> Encounters:
    return replace(seen, n=seen.n - 1, n_crashes=seen.n_crashes - 1)


def _first_enough(seen: Encounters, y: FloatArray, target: float, confidence: float) -> int | None:
    """Length of the least part of `y` (n,) that ends with a crash and is enough, if any."""
    for row in np.flatnonzero(y == 1):
        if enough(seen + Encounters.of(y[: row + 1]), target, confidence):
            return int(row) + 1
    return None


def _stopped(problem: Problem, seen: Encounters) -> Snapshot:
    snapshot = _snapshot(_but_last(seen), inverse_interval(seen, problem.confidence))
    return replace(snapshot, stop_reason=StopReason.TARGET_MET)


def _ended(problem: Problem, seen: Encounters) -> Snapshot:
    """The budget is no outcome: what it leaves is a fixed number of encounters."""
    low, high = interval = seen.interval(problem.confidence)
    target = problem.target_at(seen.n_runs)
    met = seen.n_crashes > 0 and (high - low) / 2 <= target * seen.share
    stop = StopReason.TARGET_MET if met else StopReason.BUDGET_ENDED
    return replace(_snapshot(seen, interval), stop_reason=stop)


def _snapshot(seen: Encounters, interval: tuple[float, float]) -> Snapshot:
    k, n, p = seen.n_crashes, seen.n, seen.share
    alarms = {
        Alarm.NO_CRASH_FOUND: n > 0 and not k,
        Alarm.WEIGHTS_CONCENTRATED: 0 < k < 1 / SHARE_LIMIT,
    }
    return Snapshot(
        probability=p,
        interval=interval,
        standard_error=math.sqrt(p * (1 - p) / (n - 1)) if n > 1 else math.inf,
        n_eff=float(k),
        largest_weight_share=1 / k if k else 1.0,
        log_efficiency=1.0 if 0 < k < n else math.nan,
        alarms=tuple(alarm for alarm, is_raised in alarms.items() if is_raised),
        phase=PHASE,
    )
