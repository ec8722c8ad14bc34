"""What a risk order leaves out: it claims that nothing depends on it, which is tested.

Variables that no risk coordinate depends on, and directions in which none of them changes. Runs
hardly tell by themselves. Where such a direction makes situations crash at values that traffic
seldom has, the surrogate, which sees risk coordinates alone, holds all of them safe, and no draw
goes there: an estimate came out at half the probability, narrow and without an alarm. So
situations that the order holds to be safe are simulated far out along such directions. One that
crashes, while one that the order holds no less dangerous does not, refutes the order: the
variables themselves take its place.
"""

from collections.abc import Generator
from dataclasses import replace
from itertools import product

import numpy as np

from crashrate.crash_set.blind import Blind
from crashrate.crash_set.fronts import above_any, maximal
from crashrate.estimation.exploration import wide_pool
from crashrate.estimation.labels import Labels
from crashrate.estimation.probing import ask, farthest, likeliest, reachable
from crashrate.estimation.refutation import DEEP
from crashrate.estimation.strategy import Problem, Query, Snapshot
from crashrate.variables import FloatArray

# Shares of the way from the middle to the farthest value along a direction, beyond which is looked:
# the farther out, the less dangerous is what else is likely enough.
FAR_OUT = (0.6, 0.85, 0.97)
N_ALONE = 3  # runs at each of these where one direction is left out; one where several are
MANY = 4  # directions, beyond which there are two shares of three
N_OBLIQUE = 12  # looks between axes, of more than two directions
OBLIQUE = 0.85  # their share
ENOUGH = 3  # times as many places to choose from as are wanted
SAME = 1e-9  # of the risk coordinates, for rounding
UNUSUAL, N_TWINS = 0.5, 2  # standard deviations; twins at a time of outcomes that contradict it


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
    if labels.learned is None or problem.blind is None:
        return labels, True
    told, before = replace(snapshot, phase="learn"), labels.n
    safe, blind = _safe_by_order(problem, labels, unit, rng), problem.blind
    x = _far_out(blind, *safe, labels.x, rng)
    labels = yield from ask(problem, labels, x, told)
    crashed = labels.x[before:][labels.y[before:] == 1]
    twins = _twins(problem, labels, *safe, crashed)
    labels = yield from ask(problem, labels, twins, told)
    whole = labels.n == before + len(x) + len(twins)
    # a failed run clears nothing, and nor does a crash without a twin
    refuted = (labels.y[before + len(x) :] != 1).any() or len(twins) < len(crashed)
    return labels.by_variables() if refuted else labels, whole


def check_contradicted(
    problem: Problem, labels: Labels, snapshot: Snapshot
) -> Generator[Query, FloatArray, Labels]:
    """Simulate twins, as usual, of outcomes that contradict an order: equal coordinates end alike.

    The outcomes by variables, without an order, where they do not.
    """
    if labels.learned is None or problem.blind is None or not labels.contradictions:
        return labels
    rows = np.flatnonzero(labels.known)[labels.learned.contradicted]
    out = np.linalg.norm(problem.blind.displaced(labels.x[rows]), axis=1)
    rows = rows[np.argsort(-out, kind="stable")][: np.count_nonzero(out > UNUSUAL)]
    usual = problem.blind.undone(labels.x[rows])
    new = [
        k
        for k, row in enumerate(rows)
        if problem.traffic.contains(usual[k : k + 1])[0]
        and not (labels.x == usual[k]).all(axis=1).any()
        and _same(labels, usual[k], labels.u[row])
    ][:N_TWINS]
    before = labels.n
    labels = yield from ask(problem, labels, usual[new], replace(snapshot, phase="learn"))
    y = labels.y[before:]
    differ = y != labels.y[rows[new]][: len(y)]
    return labels.by_variables() if (differ & ~np.isnan(y)).any() else labels


def most_runs(problem: Problem) -> int:
    """Runs that such a look may take, but for those as usual."""
    looks = _looks(problem.blind.n, problem.rng(0)) if problem.blind is not None else []
    return sum(n for _, _, n in looks)


def _looks(k: int, rng: np.random.Generator) -> list[tuple[FloatArray, float, int]]:
    """Where to look along k directions: a way (k,), a share of it, and how many runs."""
    axes = np.concatenate([np.eye(k), -np.eye(k)])
    if k <= 2:
        oblique = np.array(list(product((1, -1), repeat=2)))[:, :k] if k == 2 else axes[:0]
        ways = np.concatenate([axes, oblique / np.sqrt(2)])
        return [(way, share, N_ALONE if k == 1 else 1) for way in ways for share in FAR_OUT]
    shares = FAR_OUT if k <= MANY else FAR_OUT[:2]
    pairs = np.array([rng.choice(k, 2, replace=False) for _ in range(N_OBLIQUE)])
    between = np.zeros((N_OBLIQUE, k))
    np.put_along_axis(between, pairs, rng.choice((-1.0, 1.0), pairs.shape) / np.sqrt(2), axis=1)
    looks = [(way, share, 1) for way in axes for share in shares]
    return looks + [(way, OBLIQUE, 1) for way in between]


def _safe_by_order(
    problem: Problem, labels: Labels, unit: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Situations (N, d), and their coordinates, that lie deep below a safe outcome.

    In units (m,): a ripple at the edge is no crash. And none that is far less likely than the
    likeliest crash.
    """
    pool = wide_pool(problem, labels, rng)
    near = reachable(pool, likeliest(problem, labels))
    safe = labels.implied(pool.u[near])[1] & labels.implied_deep(pool.u[near], DEEP * unit)
    return pool.x[near[safe]], pool.u[near[safe]]


def _far_out(
    blind: Blind, x: FloatArray, u: FloatArray, runs: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Some of `x` (N, d) far out along what is left out, the most dangerous else."""
    displaced, found = blind.displaced(x), x[:0]
    for way, share, n in _looks(blind.n, rng):
        along = displaced @ way
        far = np.flatnonzero((along > 0) & (along >= share * along.max(initial=0.0)))
        known = np.concatenate([runs, found])
        found = np.concatenate([found, _most_dangerous(x[far], u[far], known, n)])
    return found


def _most_dangerous(x: FloatArray, u: FloatArray, runs: FloatArray, n: int) -> FloatArray:
    """`n` of `x` (k, d), far from all `runs`, that hardly any other is more dangerous than."""
    left, top = np.arange(len(u)), np.empty(0, dtype=int)
    while len(top) < ENOUGH * n and len(left):  # one coordinate has a single most dangerous place
        first = above_any(u[left], maximal(u[left]))
        top, left = np.concatenate([top, left[first]]), left[~first]
    return np.asarray(x[farthest(x, runs, top, n)])


def _twins(
    problem: Problem, labels: Labels, x: FloatArray, u: FloatArray, crashed: FloatArray
) -> FloatArray:
    """For each of those that `crashed` (n, d) one as usual that is no less dangerous by the order.

    Of `x` (N, d) with coordinates `u` (N, m) where the same coordinates are not to be had; none
    where there is none.
    """
    if problem.blind is None or not len(crashed):
        return crashed[:0]
    displaced = np.square(problem.blind.displaced(x)).sum(axis=1)
    found = []
    for crash, usual in zip(crashed, problem.blind.undone(crashed), strict=True):
        danger = labels.coordinates(crash[None])
        if problem.traffic.contains(usual[None])[0] and _same(labels, usual, danger):
            found.append(usual)
            continue
        above = np.flatnonzero((u >= danger).all(axis=1) & (x != crash).any(axis=1))
        if len(above):
            found.append(x[above[displaced[above].argmin()]])
    return np.array(found).reshape(-1, x.shape[1])


def _same(labels: Labels, x: FloatArray, u: FloatArray) -> bool:
    """Whether situation `x` (d,) has the coordinates `u` (1, m)."""
    return bool(np.allclose(labels.coordinates(x[None]), u, rtol=SAME, atol=SAME))
