"""Crude Monte Carlo: random encounters, for when exploration finds no crash."""

from collections.abc import Generator
from dataclasses import replace

import numpy as np

from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.estimation.encounters import interval
from crashrate.estimation.labels import Labels
from crashrate.estimation.strategy import Problem, Query, Snapshot
from crashrate.variables import FloatArray

CRUDE = 1_000_000  # the random stream, beside those of the rounds


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
    while labels.n < problem.max_calls:
        # drawn whole and then cut, so that a larger budget goes on with the same draws
        x = problem.traffic.sample(problem.batch_size, rng)[: problem.max_calls - labels.n]
        y = yield Query(x, _nothing(problem, labels, n_safe, n_failed))
        labels = labels.add(x, y)
        if (y == 1).any():
            return labels
        n_failed += int(np.isnan(y).sum())
        n_safe += int((y == 0).sum())
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
