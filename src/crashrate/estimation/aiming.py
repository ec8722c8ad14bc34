"""Where the next pool is drawn: fitted to where the last one says that crashes and doubts are."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from crashrate.estimation.exploration import INFLATION, inflated
from crashrate.estimation.view import View
from crashrate.sampling.gaussians import fit_gaussians
from crashrate.sampling.pool import Blend, Density, Pool
from crashrate.traffic.model import TrafficModel
from crashrate.variables import FloatArray

N_COMPONENTS = 12
N_FIT = 1000  # draws per aim that the proposal is fitted to
WIDEN = 1.3
# Of the pool: the fit; the same three times as wide, for what lies beside all that earlier pools
# reached is else never drawn; traffic itself (bounds the weights by 10); inflated traffic.
SHARES, BESIDE = (0.7, 0.1, 0.1, 0.1), 9.0


def aim(traffic: TrafficModel, views: Sequence[View], rng: np.random.Generator) -> Blend:
    """A proposal fitted to `views` of one pool in equal parts, and three defensive shares."""
    pool = views[0].pool
    aims = [p for view in views for p in _aims(view)]
    rows = np.concatenate([rng.choice(len(pool.x), N_FIT, p=p) for p in aims])
    fitted = fit_gaussians(pool.x[rows], N_COMPONENTS, rng)
    fitted = replace(fitted, covariances=fitted.covariances * WIDEN)
    beside = replace(fitted, covariances=fitted.covariances * BESIDE)
    return Blend(SHARES, (fitted, beside, traffic, inflated(traffic, (INFLATION,))))


def beside(proposal: Density, pool: Pool) -> FloatArray:
    """Share (n,) of the density at draws of `pool` that the widened fit of its proposal has.

    One for all where nothing was fitted yet.
    """
    if not isinstance(proposal, Blend):
        return np.ones(len(pool.x))
    log = np.log(SHARES[1]) + proposal.densities[1].log_density(pool.x)
    return np.asarray(np.exp(log - pool.log_q))


def _aims(view: View) -> list[FloatArray]:
    aims = [view.target, view.learning]
    if view.ordered and (undecided := view.weights * view.undecided).sum() > 0:
        aims.append(undecided / undecided.sum())
    return aims
