"""Surveys: where no risk order speaks, runs far from all others, wherever traffic may reach.

A surrogate takes what no run came near for safe. Its crash set grows from the first crash found;
another, or a far end of the same, stays unseen, and half a probability with it. Before it is
trusted, and again when the target is met, the emptiest places are looked at: a crash where the
surrogate was sure of safety refutes what was estimated before. With a risk order only those are
left to look at that no outcome decides, and once the target is met is early enough; other kernels
then say where else to look.

And it takes what lies behind an edge for crashes. A notch in that edge, or a pocket behind it, has
few runs: they keep to where the surrogate doubts. So the last look goes there too, and a safe
outcome where it was sure refutes as much as a crash.
"""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from crashrate.crash_set.surrogate import Surrogate
from crashrate.estimation.aiming import beside
from crashrate.estimation.belief import Belief
from crashrate.estimation.contesting import SURE, contested
from crashrate.estimation.exploration import wide_pool
from crashrate.estimation.labels import Labels
from crashrate.estimation.local_units import farthest_locally
from crashrate.estimation.probing import (
    RARE_MASS,
    ask,
    farthest,
    farthest_as_scaled,
    likeliest,
    reachable,
)
from crashrate.estimation.strategy import Problem, Query, Snapshot
from crashrate.estimation.view import normalised, see
from crashrate.sampling.pool import draw_pool
from crashrate.variables import FloatArray

# Without an order, before anything is estimated: runs in the emptiest places, and where a crash
# would be likelier than known ones: of these so many for each variable, and in more than
# FEW_COORDINATES, where they would be too few anyway, as many as in one. No more of them once none
# is farther from all runs than cells of traffic, up to FILLED standard deviations, are wide if
# there is one for CROWDED places.
N_FIRST, N_DENSER_FIRST = 14, 21
FILLED, CROWDED = 4.0, 1.5
# In the last look: where crashes would be about as likely as known ones, beside those, and where
# they would be likelier.
N_ALIKE, N_BESIDE, N_DENSER = 4, 5, 6
N_AGAIN = 10  # the same in more than a few coordinates, where no more than emptiness was measured
N_NEXT = 2  # next to each of those that failed
# In log density, for each variable below (at least so much in all) and in all above the likeliest
# crash: about as likely.
BELOW, LEAST_BELOW, ABOVE = 1.0, 2.0, 0.5
MAX_SURVEYS = 6
SURPRISE = 0.5  # a crash less likely than this was not expected
# With an order: runs for each coordinate (one in few coordinates), of those where the surrogate is
# sure of safety; as many far from all others as where that is contested. None where all such places
# have less than the share LITTLE of the estimate.
N_EACH, FEW_COORDINATES, LITTLE = 2, 3, 0.05
# Runs where only the surrogate says that a crash is so likely (and without an order, where more
# hangs on it), and the size of the pool they are drawn from.
N_INSIDE, N_UNORDERED, SURE_OF_CRASH, N_POOL = 3, 4, 0.9, 20_000

Rivals = Callable[[], Sequence[Surrogate]]  # called where they are needed: they have to be fitted


@dataclass(frozen=True)
class Look:
    """What a last look met.

    Parameters
    ----------
    labels : Labels
    surprised : bool
        A crash where none was believed, or none where one was sure: it has to be learned anew.
    doubted : bool
        No crash where one was likely: the rounds are to be weighed anew.
    whole : bool
        Whether the budget let it look everywhere.
    """

    labels: Labels
    surprised: bool
    doubted: bool
    whole: bool


def first_survey(
    problem: Problem, labels: Labels, n_before: int, rng: np.random.Generator
) -> Generator[Query, FloatArray, Labels]:
    """Look at the emptiest places before anything is estimated, unless `n_before` runs did."""
    x = emptiest(problem, labels, max(N_FIRST - n_before, 0), rng)
    d = problem.traffic.n_variables
    n = N_DENSER_FIRST * (d if d <= FEW_COORDINATES else 1)
    least = FILLED * (CROWDED / max(n, 1)) ** (1 / d)  # a search may have filled that space before
    x = np.concatenate([x, _denser(problem, labels, x, n, rng, least=least)])
    return (yield from ask(problem, labels, x))


def survey(
    problem: Problem,
    belief: Belief,
    rivals: Rivals,
    snapshot: Snapshot,
    rng: np.random.Generator,
) -> Generator[Query, FloatArray, Look]:
    """Look again; with an order also where `rivals` see crashes, and where only the surrogate does.

    Safe outcomes count among the latter alone: the emptiest places may lie where it supposes
    crashes by far too little to know.
    """
    labels = belief.labels
    if belief.ordered:
        outside = _silent(problem, belief, rivals, snapshot.probability, rng)
    else:
        few = problem.traffic.n_variables <= FEW_COORDINATES
        outside = _unseen(problem, belief, rng) if few else emptiest(problem, labels, N_AGAIN, rng)
    x = np.concatenate([outside, supposed(problem, belief, snapshot.probability, rng)])
    n, before = len(x), labels.n
    labels = yield from ask(problem, labels, x, snapshot)
    failed = np.flatnonzero(np.isnan(labels.y[before:]))
    if len(failed) and not belief.ordered:
        x = np.concatenate([x, _next_to(problem, belief, x[failed], rng)])
        labels = yield from ask(problem, labels, x[n:], snapshot)
    y = labels.y[before:]
    h, place = belief.see(x).surrogate_h[: len(y)], np.arange(len(y))
    safe = (y == 0) & (place >= len(outside)) & (place < n)
    surprising = ((y == 1) & (h < SURPRISE)) | (safe & (h > 1 - SURE))
    return Look(labels, bool(surprising.any()), bool(safe.any()), len(y) == len(x))


def _silent(
    problem: Problem,
    belief: Belief,
    rivals: Rivals,
    probability: float,
    rng: np.random.Generator,
) -> FloatArray:
    """Situations (n, d) that no outcome decides and the surrogate is sure are safe.

    Far from all runs, and where a rival contests it. None where all of those together would add
    next to nothing to the `probability`.
    """
    labels = belief.labels
    pool = wide_pool(problem, labels, rng)
    near = reachable(pool, likeliest(problem, labels))
    open_ = near[~np.logical_or(*labels.presumed(pool.u[near]))]
    rows = open_[belief.see(pool.x[open_]).surrogate_h < SURE]
    if pool.weights[rows].sum() <= LITTLE * probability:
        return pool.x[:0]
    m = pool.u.shape[1]
    n = m if m <= FEW_COORDINATES else N_EACH * m
    far = pool.x[farthest(pool.u, labels.u, rows, n)]
    return np.concatenate([far, contested(problem, belief, rivals(), n, rng)])


def _unseen(problem: Problem, belief: Belief, rng: np.random.Generator) -> FloatArray:
    """Situations (n, d) that tell, without an order, whether the surrogate saw all crashes.

    Far from all runs as it measures, and about as likely as the likeliest crash: a crash set that
    goes on where no run came does so at its density. The same where only the widened fit to the
    crashes reaches: one in pieces has others beside. And where more would hang on a crash.
    """
    labels, z = belief.labels, belief.standardise
    pool = draw_pool(belief.proposal, problem.traffic, labels.coordinates, N_POOL, rng)
    view, known = see(pool, labels, belief.surrogate, z), likeliest(problem, labels)
    below = max(BELOW * pool.x.shape[1], LEAST_BELOW)
    alike = (pool.log_f > known - below) & (pool.log_f < known + ABOVE)
    rows = np.flatnonzero(alike & (view.surrogate_h < SURE) & ~view.failing)
    places, runs = z(pool.u), z(labels.u)
    far = farthest_as_scaled(places, runs, rows, N_ALIKE)
    runs, worth = np.concatenate([runs, places[far]]), beside(belief.proposal, pool)
    near = farthest_as_scaled(places, runs, rows, N_BESIDE, worth)
    found = np.concatenate([far, near])
    x = pool.x[found]
    return np.concatenate([x, _denser(problem, labels, x, N_DENSER, rng)])


def _denser(
    problem: Problem,
    labels: Labels,
    chosen: FloatArray,
    n: int,
    rng: np.random.Generator,
    *,
    least: float = 0.0,
) -> FloatArray:
    """Situations (n, d) denser than the likeliest crash, far from all runs and those `chosen`."""
    wide = wide_pool(problem, labels, rng)
    rows = np.flatnonzero(wide.log_f >= likeliest(problem, labels) + ABOVE)
    runs = np.concatenate([labels.x, chosen])
    x, log_f = wide.x[rows], wide.log_f[rows]
    return np.asarray(x[farthest_locally(problem.traffic, x, runs, log_f, n, least=least)])


def _next_to(
    problem: Problem, belief: Belief, failed: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Situations (n, d) next to those that `failed`: alone, none of them says that all there fail.

    (The interval counts as crashes what lies where several failed runs are the nearest.)
    """
    pool, z = wide_pool(problem, belief.labels, rng), belief.standardise
    places = z(belief.labels.coordinates(failed))
    return np.asarray(pool.x[np.unique(cKDTree(z(pool.u)).query(places, k=N_NEXT)[1])])


def supposed(
    problem: Problem, belief: Belief, probability: float, rng: np.random.Generator
) -> FloatArray:
    """A few situations (n, d) that only the surrogate holds to crash, and surely.

    As likely as they are in traffic. None where simulations fail, and none at all where all of
    those together are next to nothing of the `probability`.
    """
    labels = belief.labels
    pool = draw_pool(belief.proposal, problem.traffic, labels.coordinates, N_POOL, rng)
    view = see(pool, labels, belief.surrogate, belief.standardise)
    decided = np.logical_or(*labels.presumed(pool.u))
    sure = (view.surrogate_h > SURE_OF_CRASH) & ~decided & ~view.failing
    mass = np.where(sure, pool.weights, 0.0)
    if mass.sum() <= LITTLE * probability:
        return pool.x[:0]
    n = N_INSIDE if belief.ordered else N_UNORDERED
    return np.asarray(pool.x[np.unique(rng.choice(len(mass), n, p=normalised(mass)))])


def emptiest(problem: Problem, labels: Labels, n: int, rng: np.random.Generator) -> FloatArray:
    """Situations (n, d) each the farthest from all runs: half where a crash would matter most."""
    pool = wide_pool(problem, labels, rng)
    known = likeliest(problem, labels)
    near = reachable(pool, known) if known > -np.inf else np.empty(0, dtype=int)
    first = farthest(pool.u, labels.u, near, n // 2)
    everywhere = reachable(pool, least=RARE_MASS)
    seen = np.concatenate([labels.u, pool.u[first]])
    rest = farthest(pool.u, seen, everywhere, n - len(first))
    return np.asarray(pool.x[np.concatenate([first, rest])])
