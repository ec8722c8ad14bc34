"""Odd crashes: where the risk order holds that none can be, looked at more closely.

A crash in the midst of what many safe outcomes imply to be safe is a freak, or the first sight of
crashes that the order denies. Taken for a freak, forty times the estimate was lost. Runs beside it
tell: a freak is alone.
"""

from collections.abc import Generator
from dataclasses import replace

import numpy as np

from crashrate.crash_set.surrogate import IntArray
from crashrate.estimation.labels import MAX_AGAINST, Labels
from crashrate.estimation.probing import Asking, ask
from crashrate.estimation.refutation import DEEP
from crashrate.estimation.state import State
from crashrate.estimation.strategy import Problem, Query, Snapshot
from crashrate.estimation.view import Standardiser, View
from crashrate.variables import FloatArray

N_BESIDE = 3  # runs at a time, …
STEPS = (0.1, 0.2, 0.4, 0.8)  # … ever farther off, in spreads of `View.breadth`, while most crash
N_TRIED = 50  # situations beside it, of which some may lie outside the box or have no coordinates


def look_closer(
    problem: Problem, state: State, view: View, snapshot: Snapshot, rng: np.random.Generator
) -> Generator[Query, FloatArray, State]:
    """Look beside the first odd crash not followed yet; the same state if there is none."""
    rows = np.setdiff1d(odd(state.labels, state.model.standardise.unit), state.followed)
    if not len(rows):
        return state
    scale = Standardiser.weighted(view.pool.x, view.breadth).scale
    before, row, told = state.labels, int(rows[0]), replace(snapshot, phase="learn")
    labels = yield from follow(problem, before, row, scale, rng=rng, snapshot=told)
    followed = (*state.followed, row, *range(before.n, labels.n))
    return replace(state, labels=labels, followed=followed)


def odd(labels: Labels, unit: FloatArray) -> IntArray:
    """Rows of crashes deep in what many safe outcomes imply.

    Parameters
    ----------
    labels : Labels
    unit : ndarray, shape (m,)
        Of the risk coordinates, for what is deep.
    """
    if labels.learned is None or not labels.contradictions:
        return np.empty(0, dtype=int)
    contradicted = np.flatnonzero(labels.known)[labels.learned.contradicted]
    crashes = contradicted[labels.y[contradicted] == 1]
    deep = (labels.contradiction_gaps(unit) > DEEP).sum(axis=1) > MAX_AGAINST
    return np.asarray(crashes[deep])


def follow(
    problem: Problem,
    labels: Labels,
    row: int,
    scale: FloatArray,
    *,
    rng: np.random.Generator,
    snapshot: Snapshot,
) -> Asking:
    """Simulate beside the odd crash of this row, ever farther off while most of it crashes.

    `scale` (d,) is that of the variables.
    """
    for step in STEPS:
        x, before = _beside(problem, labels.x[row], step * scale, rng), labels.n
        x = x[labels.has_coordinates(x)][:N_BESIDE]
        labels = yield from ask(problem, labels, x, snapshot)
        crashed = labels.y[before:] == 1
        if 2 * crashed.sum() <= len(crashed):
            break
    return labels


def _beside(
    problem: Problem, x: FloatArray, scale: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Situations (n, d) of the box around `x` (d,), mirrored at its bounds."""
    lower, upper = problem.traffic.lower, problem.traffic.upper
    tried = x + scale * rng.standard_normal((N_TRIED, len(x)))
    tried = np.where(tried < lower, 2 * lower - tried, tried)
    tried = np.where(tried > upper, 2 * upper - tried, tried)
    return np.asarray(tried[problem.traffic.contains(tried)])
