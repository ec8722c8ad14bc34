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
# many pools agree up to the factor; of two where a batch of runs lies between them. No more than
# MOST are waited for: sums may also differ because little is known.
AGREEING, STEADY, MOST = 4, 1.1, 20


def foreseeing(state: State, wanted: View, probability: float) -> State:
    """With the surrogate's sum over one pool more, if a round would tell and none has."""
    unsure = wanted.spread.sum() > START_CV * np.sqrt(ROUND) * wanted.probability
    if unsure:
        return replace(state, foreseen=())
    return replace(state, foreseen=(*state.foreseen, probability)[-MOST:])


def ready(problem: Problem, state: State) -> bool:
    """Whether the next round estimates, if runs may still go into learning."""
    if state.ordered or state.rounds:
        return bool(state.foreseen)
    n = AGREEING if problem.batch_size <= ROUND else 2
    latest = state.foreseen[-n:]
    agree = len(latest) == n and max(latest) <= STEADY * min(latest)
    return agree or len(state.foreseen) == MOST
