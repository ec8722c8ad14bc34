"""Exploration: the first crash, and the crash set's edge near the likeliest crashes.

With a risk order: inflate the traffic model until its most dangerous draw crashes, bisect down the
chain of draws sorted by danger, then search along lines from the likeliest crash to ordinary
traffic. Without one: a space-filling search over everything that traffic can reach.
"""

from collections.abc import Generator
from dataclasses import dataclass

import numpy as np

from crashrate.crash_set.fronts import maximal
from crashrate.estimation.labels import Labels
from crashrate.estimation.probing import (
    NEGLIGIBLE_MASS,
    Asking,
    ask,
    farthest,
    likeliest,
    probe,
    reachable,
)
from crashrate.estimation.strategy import Problem, Query
from crashrate.estimation.usable import require_usable
from crashrate.sampling.gaussians import Gaussians
from crashrate.sampling.pool import Pool, draw_pool
from crashrate.traffic.model import TrafficModel
from crashrate.variables import FloatArray

N_WIDE = 80_000
N_ORDINARY = 6000
N_RANKED = 1000
INFLATION = 4.0
INFLATION_STEP = 1.5
MAX_INFLATIONS = 8
CHAIN_LEVELS = 64
RUNS_PER_LINE = 4
HALVINGS_PER_LINE = 12
# Without an order: shares of traffic's probability that are left out, runs, and whether they look
# for small sets. The first few, far out, find what lies beyond a bound however rare it is; small
# sets lie among what is less rare.
FILLING = ((NEGLIGIBLE_MASS, 15, False), (1e-7, 135, True), (NEGLIGIBLE_MASS, 50, False))
# In up to so many variables runs that look for small sets keep as far off what is left out as from
# each other: on its border one sees half as much. And where a crash was found before there were so
# many of them for each variable, the others follow where another would matter. In more variables
# they would be too few; nearly everything is near the border then, and corners, which go on beyond
# it, are what there is to find.
MAX_MESHED, MESH = 2, 50
MAX_SPREAD = 0.5  # standard deviation of an inflated component, in widths of the box
MAX_ORDINARY = 50
ORDINARY_CRASHES = 0.1  # expected crashes among the ordinary draws above which they are not safe

Exploration = Generator[Query, FloatArray, "Explored"]


@dataclass(frozen=True)
class Explored:
    """What exploration leaves to the rounds.

    Parameters
    ----------
    labels : Labels
    wide : Gaussians
        The inflated traffic model in which the crash was found.
    ordinary : ndarray, shape (n, m)
        Risk coordinates of draws of the traffic model; empty where crashes are common among them.
    n_filling : int
        Runs that went to the emptiest places, in search of a crash.
    """

    labels: Labels
    wide: Gaussians
    ordinary: FloatArray
    n_filling: int = 0

    @property
    def found(self) -> bool:
        """Whether a crash was seen."""
        return bool((self.labels.y == 1).any())

    def most_dangerous(self, rng: np.random.Generator) -> FloatArray:
        """Some of the ordinary draws no other one of which is more dangerous; the order says so."""
        return rng.permutation(maximal(self.ordinary))[:MAX_ORDINARY]


def ordinary_is_safe(probability: float) -> bool:
    """Whether `N_RANKED` draws of traffic may be taken as safe at this crash probability."""
    return probability * N_RANKED <= ORDINARY_CRASHES


def inflated(traffic: TrafficModel, factors: tuple[float, ...]) -> Gaussians:
    """The traffic model's components, equally weighted, with covariances times each factor.

    Around the means of the *truncated* components, and no wider than `MAX_SPREAD` of the box: a
    component far outside the box, or much wider, would send hardly a draw into it.
    """
    k = traffic.n_components * len(factors)
    covariances = np.concatenate([traffic.covariances * f for f in factors])
    widest = MAX_SPREAD * (traffic.upper - traffic.lower)
    shrink = np.minimum(widest / np.sqrt(np.diagonal(covariances, axis1=1, axis2=2)), 1.0)
    return Gaussians(
        np.full(k, 1 / k),
        np.concatenate([traffic.component_means] * len(factors)),
        covariances * shrink[:, :, None] * shrink[:, None],
    )


def explore(problem: Problem, n_lines: int) -> Exploration:
    """Find a crash, and along `n_lines` lines where the crash set begins; see the module."""
    rng, labels, n_filling = problem.rng(0), Labels.empty(problem), 0
    ordinary = problem.traffic.sample(N_ORDINARY, rng)
    if problem.order is not None:
        # from a stream of its own: whether an order can be used does not depend on the seed
        x = inflated(problem.traffic, factors(INFLATION)).sample(N_WIDE, np.random.default_rng(0))
        u = labels.coordinates(x[problem.traffic.contains(x)])
        require_usable(problem.order.names, u)
        labels, wide, pool = yield from _inflate(problem, labels, rng)
        if (labels.y == 1).any():
            labels = yield from probe(problem, labels, pool)
        elif (labels.y == 0).any():
            labels = _given_up(problem, labels)  # its most dangerous situations are safe
    if not (labels.y == 1).any():
        wide = inflated(problem.traffic, factors(INFLATION))
        before = labels.n
        labels = yield from _fill_space(problem, labels, rng)
        missing = MESH * labels.u.shape[1] - (labels.n - before)
        if (labels.y == 1).any() and labels.u.shape[1] <= MAX_MESHED and missing > 0:
            labels = yield from _mesh(problem, labels, missing, rng)
        n_filling = labels.n - before
    if (labels.y == 1).any():
        labels = yield from _search_lines(problem, labels, ordinary[:n_lines])
    labels, u = yield from _check_ordinary(problem, labels, ordinary)
    return Explored(labels, wide, u, n_filling)


def _given_up(problem: Problem, labels: Labels) -> Labels:
    """Without the order, which may be wrong in what it leaves out."""
    return labels.by_variables() if problem.blind is not None else labels.without_order()


def factors(inflation: float) -> tuple[float, ...]:
    """Of covariances: from traffic itself to far beyond it."""
    return 1.0, inflation, inflation**2


def wide_pool(problem: Problem, labels: Labels, rng: np.random.Generator) -> Pool:
    """Draws from traffic itself to far beyond it."""
    wide = inflated(problem.traffic, factors(INFLATION))
    return draw_pool(wide, problem.traffic, labels.coordinates, N_WIDE, rng)


def danger(u: FloatArray) -> FloatArray:
    """Minimum over coordinates of the rank of `u` (n, m), shape (n,): a chain through the set."""
    ranks = np.argsort(np.argsort(u, axis=0), axis=0)
    return np.asarray(ranks.min(axis=1))


def _inflate(
    problem: Problem, labels: Labels, rng: np.random.Generator
) -> Generator[Query, FloatArray, tuple[Labels, Gaussians, Pool]]:
    """Inflate the traffic model until its most dangerous draw crashes; go down from there."""
    for step in range(MAX_INFLATIONS):
        wide = inflated(problem.traffic, factors(INFLATION * INFLATION_STEP**step))
        pool = draw_pool(wide, problem.traffic, labels.coordinates, N_WIDE, rng)
        worst = int(np.argmax(danger(pool.u)))
        labels = yield from ask(problem, labels, pool.x[worst : worst + 1])
        if (labels.y == 1).any():
            return (yield from _descend(problem, labels, pool)), wide, pool
    # no draw lies in a corner of the box; where danger grows towards it, it is the place to look
    x = pool.x[worst]
    corner = _to_bounds(problem, labels, x, pool)
    if not np.array_equal(corner, x):
        labels = yield from ask(problem, labels, corner[None])
    if (labels.y == 1).any():
        labels = yield from _search_axes(problem, labels, problem.traffic.sample(1, rng)[0])
    return labels, wide, pool


def _to_bounds(problem: Problem, labels: Labels, x: FloatArray, pool: Pool) -> FloatArray:
    """`x` (d,) moved to bounds of the box, one after another, where it is no less dangerous.

    Where the box has none, as far as the pool reaches.
    """
    box = problem.traffic.lower, problem.traffic.upper
    reached = pool.x.min(axis=0), pool.x.max(axis=0)
    ends = (np.where(np.isfinite(b), b, r) for b, r in zip(box, reached, strict=True))
    for i, bounds in enumerate(zip(*ends, strict=True)):
        for bound in bounds:
            moved = np.where(np.arange(len(x)) == i, bound, x)
            if _dominates(moved, x, labels):
                x = moved
    return x


def _dominates(x: FloatArray, y: FloatArray, labels: Labels) -> bool:
    """Whether the order holds situation `x` (d,) to be no less dangerous than `y`."""
    both = np.stack([x, y])
    if not labels.has_coordinates(both).all():
        return False
    u, v = labels.coordinates(both)
    return bool((u >= v).all())


def _descend(problem: Problem, labels: Labels, pool: Pool) -> Asking:
    """Bisect down the chain of draws sorted by danger."""
    chain = np.argsort(-danger(pool.u))
    steps = np.unique(np.geomspace(1, len(chain), CHAIN_LEVELS).round().astype(int) - 1)
    crash, safe = 0, len(steps) - 1
    while safe - crash > 1 and labels.n < problem.max_calls:
        middle = (crash + safe) // 2
        row = chain[steps[middle]]
        labels = yield from ask(problem, labels, pool.x[row : row + 1])
        crash, safe = (middle, safe) if labels.y[-1] == 1 else (crash, middle)
    return labels


def _fill_space(problem: Problem, labels: Labels, rng: np.random.Generator) -> Asking:
    """Simulate the draw farthest from all simulated ones until one crashes.

    Mostly where events that are not the rarest would be: the space beyond is as large again.
    """
    pool = wide_pool(problem, labels, rng)
    for least, most, small in FILLING:
        rows = reachable(pool, least=least)
        u, meshed = pool.u[rows], small and pool.u.shape[1] <= MAX_MESHED
        known = _and_beyond(labels, pool, rows) if meshed else labels.u
        # the places do not depend on outcomes, only how many of them are simulated
        for row in rows[farthest(u, known, np.arange(len(u)), most)]:
            if (labels.y == 1).any() or labels.n >= problem.max_calls:
                return labels
            labels = yield from ask(problem, labels, pool.x[row : row + 1])
    return labels


def _mesh(problem: Problem, labels: Labels, n: int, rng: np.random.Generator) -> Asking:
    """`n` more such draws, where another crash would matter beside the known ones."""
    pool = wide_pool(problem, labels, rng)
    rows = reachable(pool, likeliest(problem, labels))
    places = farthest(pool.u[rows], _and_beyond(labels, pool, rows), np.arange(len(rows)), n)
    return (yield from ask(problem, labels, pool.x[rows[places]]))


def _and_beyond(labels: Labels, pool: Pool, rows: np.ndarray) -> FloatArray:
    """Places (n, m) to keep off: the runs, and what of the pool is not among `rows`."""
    return np.concatenate([labels.u, np.delete(pool.u, rows, axis=0)])


def _search_lines(problem: Problem, labels: Labels, ordinary: FloatArray) -> Asking:
    """Bisect from the likeliest crash towards draws of the traffic model."""
    for safe_end in ordinary:
        density = problem.traffic.log_density(labels.crashes)
        crash_end = labels.crashes[int(np.argmax(density))]
        labels = yield from _search_line(problem, labels, safe_end, crash_end)
    return labels


def _search_axes(problem: Problem, labels: Labels, ordinary: FloatArray) -> Asking:
    """Bisect from the likeliest crash towards an ordinary draw (d,), one variable after another.

    A line towards it leaves a narrow corner at once, by the variable that it is narrowest in, and
    tells nothing of the others.
    """
    for i in range(len(ordinary)):
        density = problem.traffic.log_density(labels.crashes)
        crash = labels.crashes[int(np.argmax(density))]
        start = np.where(np.arange(len(crash)) == i, ordinary, crash)
        labels = yield from _search_line(problem, labels, start, crash)
    return labels


def _search_line(problem: Problem, labels: Labels, start: FloatArray, end: FloatArray) -> Asking:
    low, high, runs = 0.0, 1.0, 0
    for _ in range(HALVINGS_PER_LINE):
        middle = (low + high) / 2
        x = (start + middle * (end - start))[None]
        crash, safe = labels.implied(labels.coordinates(x))
        if not (crash[0] or safe[0]):
            if runs == RUNS_PER_LINE or labels.n >= problem.max_calls:
                break
            labels, runs = (yield from ask(problem, labels, x)), runs + 1
            crash = labels.y[-1:] == 1
        low, high = (low, middle) if crash[0] else (middle, high)
    return labels


def _check_ordinary(
    problem: Problem, labels: Labels, ordinary: FloatArray
) -> Generator[Query, FloatArray, tuple[Labels, FloatArray]]:
    """Draws of the traffic model that the surrogate may take as safe, their most dangerous run."""
    ranked = ordinary[-N_RANKED:]
    u = labels.coordinates(ranked)
    none = u[:0]
    if labels.implied(u)[0].any():
        return labels, none
    if labels.learned is not None:
        worst = int(np.argmax(danger(u)))
        if not labels.implied(u[worst : worst + 1])[1][0]:
            labels = yield from ask(problem, labels, ranked[worst : worst + 1])
            if labels.implied(u)[0].any():
                return labels, none
    return labels, u
