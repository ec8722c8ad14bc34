"""Bounds P(inner) ≤ p ≤ P(outer) without sampling, where they can be had in good time."""

from crashrate.crash_set.bounds import probability_bounds
from crashrate.estimation.labels import Labels
from crashrate.estimation.strategy import Problem

# corners beyond which the exact bounds take longer than bounds from draws
MAX_CORNERS = 2000


def exact_bounds(problem: Problem, labels: Labels) -> tuple[float, float] | None:
    """P(inner) and P(outer) exactly, (0, 1) without an order, None where that is out of reach."""
    if labels.learned is None or problem.order is None:
        return 0.0, 1.0
    if len(labels.learned.corners) > MAX_CORNERS:
        return None
    return probability_bounds(labels.learned, problem.order, problem.traffic)
