"""Bounds P(inner) ≤ p ≤ P(outer) without sampling, where they can be had in good time."""

from crashrate.crash_set.bounds import probability_bounds
from crashrate.errors import NumericalError
from crashrate.estimation.labels import Labels
from crashrate.estimation.strategy import Problem

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
