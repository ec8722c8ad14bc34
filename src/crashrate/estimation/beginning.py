"""How the default method begins, and begins anew where an order leaves out what matters."""

from dataclasses import replace

import numpy as np

from crashrate.estimation.exploration import Explored
from crashrate.estimation.kernels import Model
from crashrate.estimation.labels import Labels
from crashrate.estimation.state import State
from crashrate.estimation.strategy import Problem
from crashrate.estimation.view import Standardiser
from crashrate.sampling.pool import Density
from crashrate.variables import FloatArray

BEGINNING = 2_000_000  # random stream beside those of the rounds
N_POOL = 20_000


def begin(problem: Problem, explored: Explored) -> State:
    """Before the first round."""
    rng = problem.rng(BEGINNING)
    ordinary = explored.most_dangerous(rng)
    return _begun(problem, explored.labels, ordinary, explored.wide, rng)


def by_variables(problem: Problem, state: State, labels: Labels) -> State:
    """Begun anew: the outcomes by variables, without an order."""
    begun = _begun(problem, labels, labels.x[:0], state.proposal, problem.rng(BEGINNING))
    return replace(begun, k=state.k, n_surveys=state.n_surveys, followed=state.followed)


def _begun(
    problem: Problem,
    labels: Labels,
    ordinary: FloatArray,
    wide: Density,
    rng: np.random.Generator,
) -> State:
    reach = labels.coordinates(_inside(problem, wide, rng))
    standardise = Standardiser.weighted(reach, np.full(len(reach), 1 / len(reach)))
    directed = labels.learned is not None
    dropped = problem.order is not None and not directed
    return State(
        labels,
        ordinary,
        wide,
        Model(standardise),
        directed=directed,
        dropped_at=labels.n if dropped else None,
        begun_at=labels.n,
    )


def _inside(problem: Problem, wide: Density, rng: np.random.Generator) -> FloatArray:
    x = wide.sample(N_POOL, rng)
    return np.asarray(x[problem.traffic.contains(x)])
