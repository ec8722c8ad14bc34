"""For when exploration finds no crash: random encounters, and the emptiest places in turn.

Only the random encounters bound the probability; a small crash set far from traffic's bulk is found
by looking where no run has been.
"""

from collections.abc import Generator
from dataclasses import replace

import numpy as np

from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.estimation.encounters import Encounters
from crashrate.estimation.labels import Labels
from crashrate.estimation.strategy import Problem, Query, Snapshot
from crashrate.estimation.surveying import emptiest
from crashrate.variables import FloatArray

CRUDE, FAR = 1_000_000, 1_000_001  # random streams, beside those of the rounds
MAX_FAR = 2000  # a space that so many runs do not fill will not be filled
PHASE = "random encounters"


def crude(problem: Problem, labels: Labels) -> Generator[Query, FloatArray, Labels | Snapshot]:
    """Simulate random encounters until one crashes, or the budget ends.

    Returns
    -------
    Labels
        With the crash in them, for the rounds to go on from.
    Snapshot
        Where none crashed: probability 0 with the upper end that the safe random encounters leave.
    """
    rng, seen = problem.rng(CRUDE), Encounters()
    n_far = min(problem.max_calls - labels.n, MAX_FAR)
    far = emptiest(problem, labels, n_far, problem.rng(FAR))
    while labels.n < problem.max_calls:
        x = encounter(problem, rng, labels.n)
        y = yield Query(x, _nothing(problem, labels, seen))
        labels = labels.add(x, y)
        seen += Encounters.of(labels.y[-len(x) :])
        if seen.n_crashes:
            return labels
        x, far = far[: problem.batch_size], far[problem.batch_size :]
        x = x[: problem.max_calls - labels.n]
        if len(x):
            y = yield Query(x, _nothing(problem, labels, seen))
            labels = labels.add(x, y)
            if (labels.y[-len(x) :] == 1).any():
                return labels
    return replace(_nothing(problem, labels, seen), stop_reason=StopReason.BUDGET_ENDED)


def encounter(problem: Problem, rng: np.random.Generator, n_calls: int) -> FloatArray:
    """The next batch of random encounters (n, d), cut to what `n_calls` leave of the budget."""
    # drawn whole and then cut, so that a larger budget goes on with the same draws
    return problem.traffic.sample(problem.batch_size, rng)[: problem.max_calls - n_calls]


def _nothing(problem: Problem, labels: Labels, seen: Encounters) -> Snapshot:
    return Snapshot(
        probability=0.0,
        interval=seen.interval(problem.confidence),
        alarms=(Alarm.NO_CRASH_FOUND,),
        learned=labels.learned,
        phase=PHASE,
    )
