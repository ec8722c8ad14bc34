"""Random encounters until one crashes, for when exploration finds no crash."""

from collections.abc import Generator
from dataclasses import replace

import numpy as np

from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.estimation.encounters import Encounters
from crashrate.estimation.labels import Labels
from crashrate.estimation.strategy import Problem, Query, Snapshot
from crashrate.variables import FloatArray

CRUDE = 1_000_000  # the random stream, beside those of the rounds
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
    while labels.n < problem.max_calls:
        x = encounter(problem, rng, labels.n)
        y = yield Query(x, _nothing(problem, labels, seen))
        labels, seen = labels.add(x, y), seen + Encounters.of(y)
        if seen.n_crashes:
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
