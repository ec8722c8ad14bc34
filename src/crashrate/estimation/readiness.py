"""When a campaign may begin to estimate: one round would tell, and the surrogate has settled."""

from dataclasses import replace

import numpy as np

from crashrate.estimation.sizing import ROUND
from crashrate.estimation.state import State
from crashrate.estimation.strategy import Problem
from crashrate.estimation.view import View

START_CV = 0.35  # estimate as soon as one round of ten would have this coefficient of variation
# Without an order a surrogate that is sure of itself may still be growing to the size of the crash
# region that it knows, and rounds that begin before are too low with it. First the sums over so
# many pools agree up to the factor; fewer where a whole batch lies between them. No more than MOST
# are waited for: sums may also differ because little is known.
AGREEING, AGREEING_OF_BATCHES, STEADY, MOST = 4, 2, 1.1, 20


def foreseeing(state: State, wanted: View, probability: float) -> State:
    """With the surrogate's sum over one pool more, or none where a round would tell little."""
    if wanted.spread.sum() > START_CV * np.sqrt(ROUND) * wanted.probability:
        return replace(state, foreseen=())
    return replace(state, foreseen=(*state.foreseen, probability)[-MOST:])


def ready(problem: Problem, state: State) -> bool:
    """Whether the next round estimates, if runs may still go into learning."""
    if state.ordered or state.rounds:
        return bool(state.foreseen)
    n = AGREEING if problem.batch_size <= ROUND else AGREEING_OF_BATCHES
    latest = state.foreseen[-n:]
    agree = len(latest) == n and max(latest) <= STEADY * min(latest)
    return agree or len(state.foreseen) == MOST
