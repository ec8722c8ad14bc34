"""Bounds P(inner) ≤ p ≤ P(outer) without sampling, where they can be had in good time."""

import math
from dataclasses import replace

from crashrate.crash_set.bounds import probability_bounds
from crashrate.errors import NumericalError
from crashrate.estimation.labels import Labels
from crashrate.estimation.strategy import Problem, Snapshot

# Beyond these the exact bounds take longer than bounds from draws, and box probabilities in four
# or more dimensions are themselves drawn.
MAX_CORNERS, MAX_VARIABLES, MAX_COMPONENTS = 2000, 3, 40


def exact_bounds(problem: Problem, labels: Labels) -> tuple[float, float] | None:
    """P(inner) and P(outer) exactly, (0, 1) without an order, None where that is out of reach."""
    if labels.learned is None or problem.order is None:
        return 0.0, 1.0
    if problem.traffic.n_variables > MAX_VARIABLES or len(labels.learned.corners) > MAX_CORNERS:
        return None
    if problem.traffic.n_components > MAX_COMPONENTS:
        return None
    try:
        return probability_bounds(labels.learned, problem.order, problem.traffic)
    except NumericalError:  # variables so strongly correlated that a thin box does not settle
        return None


def within(snapshot: Snapshot, bounds: tuple[float, float]) -> Snapshot:
    """The estimate moved into exact bounds that no outcome contradicts, its interval with it.

    In one variable they may be a thousandth apart: an estimate beside them would contradict what
    is said beneath it. The interval only grows: it does not rest on the order alone.
    """
    (low, high), (least, most) = bounds, snapshot.interval
    moved = min(max(snapshot.probability, low), high)
    if math.isnan(moved) or moved == snapshot.probability:
        return snapshot
    reach = (low, high) if least > high or most < low else (moved, moved)
    interval = min(least, reach[0]), max(most, reach[1])
    return replace(snapshot, probability=moved, interval=interval)
