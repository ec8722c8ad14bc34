"""Probes: runs where the risk order already knows the outcome, far from all others.

Runs chosen to learn lie near the crash set's edge and cannot tell that an order is false elsewhere:
a vehicle that also crashes at the harmless end of a coordinate would be declared safe there, and
the estimate would be half the truth with a narrow interval.
"""

from collections.abc import Generator
from dataclasses import replace

import numpy as np

from crashrate.estimation.labels import Labels
from crashrate.estimation.strategy import Problem, Query, Snapshot
from crashrate.sampling.pool import Pool
from crashrate.variables import FloatArray

SAFE_PROBES, CRASH_PROBES = 4, 2
MORE_PROBES = 3  # times as many where one of them contradicts: is it the order, or a ripple?
NEGLIGIBLE_MASS = 1e-8

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


def reachable(pool: Pool) -> np.ndarray:
    """Rows of the pool that traffic reaches: all but the least dense 1e-8 of its probability."""
    by_density = np.argsort(pool.log_f)
    mass = np.cumsum(pool.weights[by_density])
    return np.asarray(by_density[mass > NEGLIGIBLE_MASS * mass[-1]])


def probe(problem: Problem, labels: Labels, pool: Pool, snapshot: Snapshot = EXPLORING) -> Asking:
    """Test the risk order where it decides, at the draws of `pool` farthest from all runs."""
    before = labels.contradictions
    labels = yield from ask(problem, labels, _untested(labels, pool, 1), snapshot)
    if labels.contradictions > before:
        labels = yield from ask(problem, labels, _untested(labels, pool, MORE_PROBES), snapshot)
    return labels


def _untested(labels: Labels, pool: Pool, times: int) -> FloatArray:
    """Decided draws far from all runs, shape (n, d)."""
    rows = reachable(pool)
    x, u = pool.x[rows], pool.u[rows]
    crash, safe = labels.implied(u)
    chosen = [
        farthest(u, labels.u, np.flatnonzero(member), n * times)
        for member, n in ((safe, SAFE_PROBES), (crash, CRASH_PROBES))
    ]
    return np.asarray(x[np.concatenate(chosen)])


def farthest(u: FloatArray, known: FloatArray, rows: np.ndarray, n: int) -> np.ndarray:
    """`n` of `rows`, each the farthest from the known points and those chosen before it.

    The first, where nothing is known, is the farthest from the center of all.
    """
    if not len(rows):
        return rows
    scale = np.where(u.std(axis=0) > 0, u.std(axis=0), 1.0)
    z, chosen = u[rows] / scale, []
    near = known / scale if len(known) else z.mean(axis=0)[None]
    distance = np.min([((z - k) ** 2).sum(axis=1) for k in near], axis=0)
    for _ in range(min(n, len(rows))):
        best = int(distance.argmax())
        chosen.append(best)
        distance = np.minimum(distance, ((z - z[best]) ** 2).sum(axis=1))
    return rows[chosen]
