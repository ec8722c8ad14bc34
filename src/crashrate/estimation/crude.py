"""For when exploration finds no crash: random encounters, and the emptiest places in turn.

Only the random encounters bound the probability; a small crash set far from traffic's bulk is found
by looking where no run has been.
"""

from collections.abc import Generator
from dataclasses import replace

import numpy as np

from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.estimation.encounters import interval
from crashrate.estimation.labels import Labels
from crashrate.estimation.strategy import Problem, Query, Snapshot
from crashrate.estimation.surveying import emptiest
from crashrate.variables import FloatArray

CRUDE, FAR = 1_000_000, 1_000_001  # random streams, beside those of the rounds
MAX_FAR = 2000  # a space that so many runs do not fill will not be filled


def crude(problem: Problem, labels: Labels) -> Generator[Query, FloatArray, Labels | Snapshot]:
    """Simulate random encounters until one crashes, or the budget ends.

    Returns
    -------
    Labels
        With the crash in them, for the rounds to go on from.
    Snapshot
        Where none crashed: probability 0 with the upper end that the safe random encounters leave.
    """
    rng, n_safe, n_failed = problem.rng(CRUDE), 0, 0
    n_far = min(problem.max_calls - labels.n, MAX_FAR)
    far = emptiest(problem, labels, n_far, problem.rng(FAR))
    while labels.n < problem.max_calls:
        # drawn whole and then cut, so that a larger budget goes on with the same draws
        x = problem.traffic.sample(problem.batch_size, rng)[: problem.max_calls - labels.n]
        y = yield Query(x, _nothing(problem, labels, n_safe, n_failed))
        labels = labels.add(x, y)
        n_failed += int(np.isnan(y).sum())
        n_safe += int((y == 0).sum())
        x, far = far[: problem.batch_size], far[problem.batch_size :]
        x = x[: problem.max_calls - labels.n]
        if len(x) and not (labels.y == 1).any():
            y = yield Query(x, _nothing(problem, labels, n_safe, n_failed))
            labels = labels.add(x, y)
        if (labels.y == 1).any():
            return labels
    end = _nothing(problem, labels, n_safe, n_failed)
    return replace(end, stop_reason=StopReason.BUDGET_ENDED)


def _nothing(problem: Problem, labels: Labels, n_safe: int, n_failed: int) -> Snapshot:
    return Snapshot(
        probability=0.0,
        interval=(0.0, interval(n_failed, n_safe + n_failed, problem.confidence)[1]),
        alarms=(Alarm.NO_CRASH_FOUND,),
        learned=labels.learned,
        phase="random encounters",
    )
