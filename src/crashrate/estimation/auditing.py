"""Audit of the order: random runs whose outcome it implies, and how much of that can be wrong.

The bracket P(inner) ≤ p ≤ P(outer) is certain if the order is exact, and worth nothing said of an
order that is not. Situations drawn at random from what is implied, simulated all the same, bound
the share of it that is wrong, whatever the vehicle does: n draws without a contradiction leave
1 - α^(1/n) (Clopper & Pearson 1934).

Of the situations implied to be safe none but a layer can be audited so: they carry nearly all of
traffic's probability, and n draws of that say nothing of shares far below 1/n.
"""

from collections.abc import Generator

import numpy as np

from crashrate.crash_set.fronts import below_any
from crashrate.estimation.encounters import interval
from crashrate.estimation.gap import N_FIT, Gap, fitted
from crashrate.estimation.labels import Labels
from crashrate.estimation.order_audit import OrderAudit
from crashrate.estimation.probing import ask
from crashrate.estimation.selection import IntArray
from crashrate.estimation.strategy import Problem, Query, Snapshot
from crashrate.estimation.view import normalised
from crashrate.sampling.pool import Density, draw_pool
from crashrate.variables import BoolArray, FloatArray

LAYER = 3.0  # times P(outer): the probability of the layer of safe situations that is audited
N_POOL = 40_000
HALVINGS = 20
MAX_DEPTH = 100.0  # of the layer, in units of `scale`
Auditing = Generator[Query, FloatArray, tuple[Labels, OrderAudit]]


def audit_order(
    problem: Problem,
    proposal: Density,
    labels: Labels,
    scale: FloatArray,
    n: int,
    *,
    rng: np.random.Generator,
    snapshot: Snapshot,
) -> Auditing:
    """Simulate `n` draws whose outcome is implied, half to crash, half to be safe.

    Parameters
    ----------
    problem : Problem
    proposal : Density
        Of a pool to begin with.
    labels : Labels
    scale : ndarray, shape (m,)
        Of the risk coordinates: in which the layer is of equal depth.
    n : int
    rng : Generator
    snapshot : Snapshot
        Goes out with the queries.
    """
    gap, layer = _seen(problem, proposal, labels, scale, rng)
    crashes = _drawn(gap, np.flatnonzero(gap.crash), n // 2, rng)
    safe = _drawn(gap, layer, n - n // 2, rng)
    # a draw that comes twice is simulated once, and counts twice
    rows, places = np.unique(np.concatenate([crashes, safe]), return_inverse=True)
    before = labels.n
    labels = yield from ask(problem, labels, gap.pool.x[rows], snapshot)
    outcomes = np.full(len(rows), np.nan)
    outcomes[: labels.n - before] = labels.y[before:]
    seen = outcomes[places.ravel()]
    wrong = (int((seen[: len(crashes)] != 1).sum()), int((seen[len(crashes) :] != 0).sum()))
    shares = [
        interval(k, m, problem.confidence)[1] if m else 1.0
        for k, m in zip(wrong, (len(crashes), len(safe)), strict=True)
    ]
    return labels, OrderAudit(
        n_crash=len(crashes),
        n_crash_wrong=wrong[0],
        crash_share=shares[0],
        n_safe=len(safe),
        n_safe_wrong=wrong[1],
        safe_share=shares[1],
        layer=float(gap.weights[layer].sum()),
        confidence=problem.confidence,
    )


def _seen(
    problem: Problem,
    proposal: Density,
    labels: Labels,
    scale: FloatArray,
    rng: np.random.Generator,
) -> tuple[Gap, IntArray]:
    """A pool with many draws where the audit is, and the rows of the layer."""
    for last in (False, False, True):
        pool = draw_pool(proposal, problem.traffic, labels.coordinates, N_POOL, rng)
        gap = Gap.of(pool, labels)
        layer = _layer(gap, labels, scale)
        if not last:
            parts = (np.flatnonzero(gap.crash), layer, gap.undecided)
            rows = [_drawn(gap, part, N_FIT, rng) for part in parts]
            proposal = fitted(pool.x[np.concatenate(rows)], problem.traffic, rng)
    return gap, layer


def _drawn(gap: Gap, rows: IntArray, n: int, rng: np.random.Generator) -> IntArray:
    """`n` of the rows as traffic has them; none where there are none."""
    if not len(rows):
        return rows
    return np.asarray(rng.choice(rows, n, p=normalised(gap.weights[rows])))


def _layer(gap: Gap, labels: Labels, scale: FloatArray) -> IntArray:
    """Rows implied to be safe, by so little that they carry LAYER times P(outer) at most.

    By so little: a rise in all risk coordinates together, as large in units of `scale`.
    """
    safe = np.flatnonzero(gap.safe)
    if labels.learned is None or not len(safe):
        return safe
    u, weights, front = gap.pool.u[safe], gap.weights[safe], labels.learned.maximal_safe
    # not beyond what there is: on a bound of traffic's box no situation is nearer to the edge
    most = np.maximum(gap.pool.u.max(axis=0), labels.u.max(axis=0))

    def within(depth: float) -> BoolArray:
        return ~below_any(np.minimum(u + depth * scale, most), front)

    low, high = 0.0, MAX_DEPTH
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        thin = weights[within(middle)].sum() <= LAYER * gap.outer
        low, high = (middle, high) if thin else (low, middle)
    return np.asarray(safe[within(low)])
