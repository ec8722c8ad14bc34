"""Contested situations: the surrogate is sure that they are safe, and a rival kernel is not.

A kernel is chosen by how well it predicts the outcomes so far, all near the known edge. What it
says beside that edge it supposes, and others, hardly worse at predicting, suppose something else.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from crashrate.crash_set.surrogate import Surrogate
from crashrate.estimation.aiming import aim
from crashrate.estimation.belief import Belief
from crashrate.estimation.strategy import Problem
from crashrate.estimation.view import View, normalised, see
from crashrate.sampling.pool import Density, draw_pool
from crashrate.variables import FloatArray

SURE = 0.01  # a crash held to be less likely than this is one that the surrogate is sure is none
N_POOL = 20_000


def contested(
    problem: Problem,
    belief: Belief,
    rivals: Sequence[Surrogate],
    n: int,
    rng: np.random.Generator,
) -> FloatArray:
    """Up to `n` undecided situations (n, d), as likely as each rival holds crashes to be there."""
    shares = [(n + i) // len(rivals) for i in reversed(range(len(rivals)))]
    parts = [_draws(problem, belief, r, k, rng) for r, k in zip(rivals, shares, strict=True)]
    return np.concatenate([np.empty((0, problem.traffic.n_variables)), *parts])


def _draws(
    problem: Problem, belief: Belief, rival: Surrogate, n: int, rng: np.random.Generator
) -> FloatArray:
    first = _view(problem, belief, rival, belief.proposal, rng)
    proposal = aim(problem.traffic, (first,), rng)
    view = _view(problem, belief, rival, proposal, rng)
    mass = view.weights * view.h
    if not mass.sum() > 0:
        return view.pool.x[:0]
    return np.asarray(view.pool.x[np.unique(rng.choice(len(mass), n, p=normalised(mass)))])


def _view(
    problem: Problem,
    belief: Belief,
    rival: Surrogate,
    proposal: Density,
    rng: np.random.Generator,
) -> View:
    """A pool as the rival sees it, crashes only where they are contested."""
    labels = belief.labels
    pool = draw_pool(proposal, problem.traffic, labels.coordinates, N_POOL, rng)
    view = see(pool, labels, rival, belief.standardise)
    sure = belief.see(pool.x).surrogate_h < SURE
    decided = np.logical_or(*labels.presumed(pool.u))  # whether or not the rival objects
    return replace(view, h=np.where(sure & ~decided & (view.h >= SURE), view.h, 0.0))
