"""Probes: runs where the risk order already knows the outcome, far from all others.

Runs chosen to learn lie near the crash set's edge and cannot tell that an order is false elsewhere:
a vehicle that also crashes at the harmless end of a coordinate would be declared safe there, and
the estimate would be half the truth with a narrow interval.
"""

from collections.abc import Generator
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from crashrate.estimation.labels import Labels
from crashrate.estimation.strategy import Problem, Query, Snapshot
from crashrate.sampling.pool import Pool
from crashrate.variables import FloatArray

SAFE_PROBES, CRASH_PROBES = 4, 2
MORE_PROBES = 3  # times as many where one of them contradicts: is it the order, or a ripple?
# Shares of traffic's probability that searches leave out: the rarest events lie in a space about
# twice as large as the others, and a small crash set is found the later in it.
RARE_MASS, NEGLIGIBLE_MASS = 1e-8, 1e-11
# In log density, and for each variable: a region of crashes as much less dense than known ones adds
# little. Of n variables typical situations lie n / 2 below the likeliest.
FAR_LESS, FOR_EACH = 2.0, 0.5

Asking = Generator[Query, FloatArray, Labels]
EXPLORING = Snapshot()


def ask(problem: Problem, labels: Labels, x: FloatArray, snapshot: Snapshot = EXPLORING) -> Asking:
    """Simulate `x`, cut to what is left of the budget, a batch at a time."""
    x = x[: problem.max_calls - labels.n]
    for start in range(0, len(x), problem.batch_size):
        batch = x[start : start + problem.batch_size]
        y = yield Query(batch, replace(snapshot, learned=labels.learned))
        labels = labels.add(batch, y)
    return labels


def reachable(pool: Pool, likeliest: float = -np.inf, least: float = NEGLIGIBLE_MASS) -> np.ndarray:
    """Rows of the pool where a crash would matter.

    All but the least dense share `least` of traffic's probability; and, once crashes are known,
    none that are far less dense than the `likeliest` of them (a log density).
    """
    by_density = np.argsort(pool.log_f)
    mass = np.cumsum(pool.weights[by_density])
    rows = by_density[mass > least * mass[-1]]
    far_less = FAR_LESS + FOR_EACH * pool.x.shape[1]
    return np.asarray(rows[pool.log_f[rows] > likeliest - far_less])


def likeliest(problem: Problem, labels: Labels) -> float:
    """Log density of the likeliest crash; -inf where there is none."""
    return float(problem.traffic.log_density(labels.crashes).max(initial=-np.inf))


def probe(problem: Problem, labels: Labels, pool: Pool, snapshot: Snapshot = EXPLORING) -> Asking:
    """Test the risk order where it decides, at the draws of `pool` farthest from all runs."""
    before = labels.contradictions
    labels = yield from ask(problem, labels, _untested(problem, labels, pool, 1), snapshot)
    if labels.contradictions > before:
        x = _untested(problem, labels, pool, MORE_PROBES)
        labels = yield from ask(problem, labels, x, snapshot)
    return labels


def _untested(problem: Problem, labels: Labels, pool: Pool, times: int) -> FloatArray:
    """Decided draws far from all runs, shape (n, d)."""
    rows = reachable(pool, likeliest(problem, labels))
    x, u = pool.x[rows], pool.u[rows]
    crash, safe = labels.implied(u)
    chosen = [
        farthest(u, labels.u, np.flatnonzero(member), n * times)
        for member, n in ((safe, SAFE_PROBES), (crash, CRASH_PROBES))
    ]
    return np.asarray(x[np.concatenate(chosen)])


def vouched_safe(problem: Problem, labels: Labels, pool: Pool, n: int) -> np.ndarray:
    """Up to `n` rows that only the order holds to be safe, far from all runs."""
    if n == 0:
        return np.empty(0, dtype=int)
    rows = reachable(pool, likeliest(problem, labels))
    safe = np.flatnonzero(labels.implied(pool.u[rows])[1])
    return np.asarray(rows[farthest(pool.u[rows], labels.u, safe, n)])


def farthest(u: FloatArray, known: FloatArray, rows: np.ndarray, n: int) -> np.ndarray:
    """`n` of `rows`, each the farthest from the known points and those chosen before it.

    In units of the spread of all. The first, where nothing is known, is the farthest from the
    center.
    """
    scale = np.where(u.std(axis=0) > 0, u.std(axis=0), 1.0)
    return farthest_as_scaled(u / scale, known / scale, rows, n)


def farthest_as_scaled(
    z: FloatArray,
    known: FloatArray,
    rows: np.ndarray,
    n: int,
    worth: FloatArray | None = None,
) -> np.ndarray:
    """The same for coordinates whose unit is that of distances, their squares times `worth`."""
    if not len(rows):
        return rows
    z, chosen = z[rows], []
    worth = np.ones(len(rows)) if worth is None else worth[rows]
    near = known if len(known) else z.mean(axis=0)[None]
    distance = cKDTree(near).query(z)[0] ** 2
    for _ in range(min(n, len(rows))):
        best = int((worth * distance).argmax())
        if not worth[best] * distance[best] > 0:  # the others are known, or worth nothing
            break
        chosen.append(best)
        distance = np.minimum(distance, ((z - z[best]) ** 2).sum(axis=1))
    return rows[chosen]
