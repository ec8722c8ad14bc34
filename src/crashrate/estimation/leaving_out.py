"""Variables that a risk order leaves out: it claims that nothing depends on them, which is tested.

Runs hardly tell by themselves. Where such a variable makes situations crash at values that traffic
seldom has, the surrogate, which sees risk coordinates alone, holds all of them safe, and no draw
goes there: an estimate came out at half the probability, narrow and without an alarm. So
situations that the order holds to be safe are simulated with such a variable as far out as traffic
reaches. One that crashes, and does not with those variables as usual, refutes the order: the
variables themselves take its place.
"""

from collections.abc import Generator
from dataclasses import replace

import numpy as np

from crashrate.crash_set.fronts import above_any, maximal
from crashrate.estimation.exploration import wide_pool
from crashrate.estimation.labels import Labels
from crashrate.estimation.probing import ask, farthest, likeliest, reachable
from crashrate.estimation.refutation import DEEP
from crashrate.estimation.strategy import Problem, Query, Snapshot
from crashrate.variables import FloatArray

# For each variable that is left out, to either side, beyond these shares of the way from its mean
# to the farthest value: the farther out, the less dangerous is what else is likely enough.
FAR_OUT, N_EACH, FEW = (0.6, 0.85), 3, 2  # one run each where more than a few are left out


def check_left_out(
    problem: Problem,
    labels: Labels,
    unit: FloatArray,
    rng: np.random.Generator,
    snapshot: Snapshot,
) -> Generator[Query, FloatArray, tuple[Labels, bool]]:
    """Simulate such situations; the outcomes by variables, without an order, if it is refuted.

    And whether the budget let all of them be simulated.
    """
    if labels.learned is None or not problem.left_out:
        return labels, True
    told, before = replace(snapshot, phase="learn"), labels.n
    x = _far_out(problem, labels, unit, rng)
    labels = yield from ask(problem, labels, x, told)
    usual = _as_usual(problem, labels.x[before:][labels.y[before:] == 1])
    labels = yield from ask(problem, labels, usual, told)
    whole = labels.n == before + len(x) + len(usual)
    # a failed run clears nothing
    refuted = (labels.y[before + len(x) :] != 1).any()
    return labels.by_variables() if refuted else labels, whole


def most_runs(problem: Problem) -> int:
    """Runs that such a look may take, but for those as usual."""
    return 2 * len(FAR_OUT) * len(problem.left_out) * _each(problem)


def _each(problem: Problem) -> int:
    return N_EACH if len(problem.left_out) <= FEW else 1


def _far_out(
    problem: Problem, labels: Labels, unit: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Situations (n, d) that the order holds safe, with a variable that it leaves out far out.

    Of the most dangerous that lie deep, in units (m,), below a safe outcome: a ripple at the edge
    refutes nothing. And none that is far less likely than the likeliest crash.
    """
    pool = wide_pool(problem, labels, rng)
    near = reachable(pool, likeliest(problem, labels))
    safe = labels.implied(pool.u[near])[1] & labels.implied_deep(pool.u[near], DEEP * unit)
    x, u = pool.x[near[safe]], pool.u[near[safe]]
    found, n, usual = labels.x[:0], _each(problem), _usual(problem)
    for i in problem.left_out:
        away = x[:, i] - usual[i]
        for way in (-away, away):
            for share in FAR_OUT:
                far = (way > 0) & (way >= share * way.max(initial=0.0))
                runs = np.concatenate([labels.x, found])
                found = np.concatenate([found, _most_dangerous(x[far], u[far], runs, n)])
    return found


def _most_dangerous(x: FloatArray, u: FloatArray, runs: FloatArray, n: int) -> FloatArray:
    """Some of `x` (n, d), far from all `runs`, that no other is more dangerous than."""
    top = np.flatnonzero(above_any(u, maximal(u)))
    return np.asarray(x[farthest(x, runs, top, n)])


def _as_usual(problem: Problem, x: FloatArray) -> FloatArray:
    """`x` (n, d) with the variables that the order leaves out as traffic has them on average."""
    usual, out = x.copy(), list(problem.left_out)
    usual[:, out] = _usual(problem)[out]
    return usual


def _usual(problem: Problem) -> FloatArray:
    return np.asarray(problem.traffic.weights @ problem.traffic.component_means)
