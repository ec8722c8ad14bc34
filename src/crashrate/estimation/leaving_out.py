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
from crashrate.estimation.probing import (
    ask,
    farthest,
    farthest_as_scaled,
    likeliest,
    reachable,
)
from crashrate.estimation.refutation import DEEP
from crashrate.estimation.selection import IntArray
from crashrate.estimation.strategy import Problem, Query, Snapshot
from crashrate.variables import FloatArray

# Shares of the way from the middle to the farthest value along a direction, beyond which is looked:
# the farther out, the less dangerous is what else is likely enough.
FAR_OUT = (0.6, 0.85, 0.97)
N_ALONE = 3  # runs at each of these where one direction is left out; one where several are
MANY = 4  # directions, beyond which there are two shares of three
N_OBLIQUE, OBLIQUE = 12, 0.85  # looks between axes, of more than two directions, and their share
# Of a mixture at most so many components, far from each other, have looks of their own, and one run
# each way: in the units of all a tight one is a point, and what lies between two is inside.
N_COMPONENTS, OF_COMPONENT = 4, 0.9
ENOUGH = 3  # times as many places to choose from as are wanted
SAME = 1e-6  # of the risk coordinates: directions are told by secants
UNUSUAL, N_TWINS = 0.5, 2  # standard deviations; twins at a time of outcomes that contradict it
Look = tuple[FloatArray, float, int]
"""A way along the directions (k,), the share of it beyond which is looked, and how many runs."""


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
    safe = _safe_by_order(problem, labels, unit, rng)
    x = _far_out(problem, *safe, labels.x, rng)
    labels = yield from ask(problem, labels, x, told)
    crashed = labels.x[before:][labels.y[before:] == 1]
    twins = _twins(problem, labels, *safe, crashed)
    labels = yield from ask(problem, labels, twins, told)
    whole = labels.n == before + len(x) + len(twins)
    # a failed run clears nothing, and nor does a crash without a twin
    refuted = (labels.y[before + len(x) :] != 1).any() or len(twins) < len(crashed)
    return labels.by_variables() if refuted else labels, whole


def check_contradicted(
    problem: Problem, labels: Labels, unit: FloatArray, snapshot: Snapshot
) -> Generator[Query, FloatArray, Labels]:
    """Simulate twins, as usual, of outcomes that contradict an order: equal coordinates end alike.

    The outcomes by variables, without an order, where they do not. Only of those that contradict it
    deeply, in units (m,): ripples may run along what an order does not see.
    """
    rows, twins = _contradicted(problem, labels, unit)
    before = labels.n
    labels = yield from ask(problem, labels, twins, replace(snapshot, phase="learn"))
    y = labels.y[before:]
    differ = (y != labels.y[rows][: len(y)]) & ~np.isnan(y)
    return labels.by_variables() if differ.any() else labels


def most_runs(problem: Problem) -> int:
    """Runs that such a look may take, but for twins."""
    if problem.blind is None:
        return 0
    k, n_components = problem.blind.n, len(_components(problem))
    return sum(n for _, _, n in _looks(k, problem.rng(0))) + 2 * k * n_components


def _contradicted(
    problem: Problem, labels: Labels, unit: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Runs that contradict the order deeply, the oddest first, and their twins that are not known.

    Twins have a run's own coordinates: as many as there are rows, N_TWINS at most.
    """
    none = np.empty(0, dtype=int), labels.x[:0]
    if labels.learned is None or problem.blind is None or not labels.contradictions:
        return none
    rows = np.flatnonzero(labels.known)[labels.learned.contradicted]
    out = np.linalg.norm(problem.blind.displaced(labels.x[rows]), axis=1)
    odd = (out > UNUSUAL) & (_depths(labels, unit) > DEEP)
    rows = rows[odd][np.argsort(-out[odd], kind="stable")]
    pairs = ((row, _usual(problem, labels, labels.x[row])) for row in rows)
    new = [
        (row, twin)
        for row, twin in pairs
        if twin is not None and not (labels.x == twin).all(axis=1).any()
    ][:N_TWINS]
    if not new:
        return none
    return np.array([row for row, _ in new]), np.array([twin for _, twin in new])


def _depths(labels: Labels, unit: FloatArray) -> FloatArray:
    """How deep each contradicted outcome is contradicted at most, in units (m,)."""
    gaps = labels.contradiction_gaps(unit)
    if labels.learned is None or not gaps.size:
        return np.empty(0)
    crash = labels.learned.crash[labels.learned.contradicted]
    depths = np.empty(len(crash))
    depths[crash], depths[~crash] = gaps.max(axis=1), gaps.max(axis=0)
    return depths


def _looks(k: int, rng: np.random.Generator) -> list[Look]:
    """Where to look along k directions."""
    axes = _axes(k)
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


def _axes(k: int) -> FloatArray:
    """Both ways along each of k directions, (2 k, k)."""
    return np.concatenate([np.eye(k), -np.eye(k)])


def _components(problem: Problem) -> IntArray:
    """Components of traffic that have looks of their own: none where there is one."""
    traffic = problem.traffic
    if traffic.n_components == 1:
        return np.empty(0, dtype=int)
    spread = np.sqrt(np.diagonal(traffic.covariance))
    own = np.sqrt(np.diagonal(traffic.covariances, axis1=1, axis2=2)) / spread
    places = np.column_stack([traffic.component_means / spread, np.log(own)])
    everything = np.append(traffic.mean / spread, np.zeros(len(spread)))
    all_of_them = np.arange(traffic.n_components)
    return farthest_as_scaled(places, everything[None], all_of_them, N_COMPONENTS)


def _safe_by_order(
    problem: Problem, labels: Labels, unit: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Situations (N, d), and their coordinates, that lie deep below a safe outcome.

    In units (m,), but not beyond what there is of a coordinate: a ripple at the edge is no crash.
    And none that is far less likely than the likeliest crash.
    """
    pool = wide_pool(problem, labels, rng)
    near = reachable(pool, likeliest(problem, labels))
    x, u = pool.x[near], pool.u[near]
    most = np.maximum(pool.u.max(axis=0), labels.u.max(axis=0))
    safe = labels.implied(u)[1] & labels.implied(np.minimum(u + DEEP * unit, most))[1]
    return x[safe], u[safe]


def _far_out(
    problem: Problem, x: FloatArray, u: FloatArray, runs: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Some of `x` (N, d) far out along what is left out, the most dangerous else."""
    blind, traffic, found = problem.blind, problem.traffic, x[:0]
    if blind is None or not len(x):
        return found
    found = _along(blind, _looks(blind.n, rng), x, u, runs)
    owner = traffic.log_component_densities(x).argmax(axis=1)
    for c in _components(problem):
        own = owner == c
        inside = blind.within(traffic.means[c], traffic.covariances[c])
        looks = [(way, OF_COMPONENT, 1) for way in _axes(blind.n)]
        known = np.concatenate([runs, found])
        found = np.concatenate([found, _along(inside, looks, x[own], u[own], known)])
    return found


def _along(
    blind: Blind, looks: list[Look], x: FloatArray, u: FloatArray, runs: FloatArray
) -> FloatArray:
    """Some of `x` (N, d) where `looks` lead, the most dangerous else."""
    displaced, found = blind.displaced(x), x[:0]
    for way, share, n in looks:
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
    for crash in crashed:
        if (usual := _usual(problem, labels, crash)) is not None:
            found.append(usual)
            continue
        danger = labels.coordinates(crash[None])
        above = np.flatnonzero((u >= danger).all(axis=1) & (x != crash).any(axis=1))
        if len(above):
            found.append(x[above[displaced[above].argmin()]])
    return np.array(found).reshape(-1, x.shape[1])


def _usual(problem: Problem, labels: Labels, x: FloatArray) -> FloatArray | None:
    """Situation `x` (d,) as usual along what the order does not see, its coordinates the same.

    Along all of it, or else along one direction; None where that changes the coordinates, leaves
    traffic's box or moves it by next to nothing.
    """
    if problem.blind is None:
        return None
    moved = problem.blind.undone(x[None])[0]
    moved = moved[problem.traffic.contains(moved)]
    out = problem.blind.displaced(np.concatenate([x[None], moved]))
    far = np.linalg.norm(out[1:] - out[0], axis=1) > UNUSUAL
    u = labels.coordinates(x[None])
    for twin in moved[far]:
        if np.allclose(labels.coordinates(twin[None]), u, rtol=SAME, atol=SAME):
            return np.asarray(twin)
    return None
