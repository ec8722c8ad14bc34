"""Problems that nobody chose: crash sets and traffic drawn at random, one campaign on each.

    python benchmarks/random_problems.py --seeds 0:100 --out random.jsonl
    python benchmarks/random_problems.py --seeds 0:100 --unordered --out random.jsonl

A method may be tuned, unnoticed, to the problems that it is measured on. Here each seed has its
own: two to six variables, one to four correlated components, some variables bounded, a crash set of
one of the `SHAPES` that danger grows into along every coordinate (in a direction drawn for each),
and a probability between 1e-8 and 1e-2. Reference: importance sampling of the set itself, a million
draws and more, to half a per cent. With ``--unordered`` the campaigns are told no risk order.

Each seed is one line of JSON; seeds already there are not run again. At the end a table by shape.
"""

import argparse
import itertools
import math
import os
import statistics
import time
from collections.abc import Callable, Mapping
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one thread a process; read by numpy's import

import numpy as np

import crashrate
from benchmark import Benchmark, Outcomes, Rows, order_of
from crashrate.sampling.gaussians import Gaussians, fit_gaussians
from crashrate.traffic.model import TrafficModel
from study import Record, clopper_pearson, mend, read, seeds, study, without

KEYS = ("seed", "ordered", "target", "max_calls", "version")
PRECISE, MOST_DRAWS = 0.005, 40
ENOUGH, LEVELS_TOLD, MOST_LEVELS = 1000, 3, 40  # of the reference's way to its level
Danger = Callable[[Rows], Rows]


def plane(rng: np.random.Generator, d: int) -> Danger:
    """Danger adds up."""
    a = rng.dirichlet(np.ones(d))
    return lambda u: np.asarray(u @ a)


def union(rng: np.random.Generator, d: int) -> Danger:
    """One of three planes is enough."""
    a = rng.dirichlet(np.full(d, 0.7), size=3)
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    return lambda u: np.asarray((u @ a.T).max(axis=1))


def intersection(rng: np.random.Generator, d: int) -> Danger:
    """Two planes at once."""
    a = rng.dirichlet(np.ones(d), size=2)
    return lambda u: np.asarray((u @ a.T).min(axis=1))


def convex(rng: np.random.Generator, d: int) -> Danger:
    """A sum of exponentials: the largest coordinate counts most."""
    a, c = rng.uniform(0.3, 1.5, d), rng.normal(0.0, 0.5, d)
    return lambda u: np.asarray(np.logaddexp.reduce(a * u + c, axis=1))


def concave(rng: np.random.Generator, d: int) -> Danger:
    """As `convex` from the other side: the smallest coordinate counts most."""
    grows = convex(rng, d)
    return lambda u: -grows(-u)


def corner(rng: np.random.Generator, d: int) -> Danger:
    """Some coordinates all beyond bounds of their own."""
    rows = rng.choice(d, rng.integers(2, d + 1), replace=False)
    c = rng.normal(0.0, 0.5, len(rows))
    return lambda u: np.asarray((u[:, rows] - c).min(axis=1))


def interplay(rng: np.random.Generator, d: int) -> Danger:
    """Coordinates that make each other worse where they are high."""
    a, b = rng.dirichlet(np.ones(d)), rng.uniform(0.0, 0.4, (d, d))

    def danger(u: Rows) -> Rows:
        high = np.maximum(u, 0.0)
        return np.asarray(u @ a + np.einsum("ni,ij,nj->n", high, b, high))

    return danger


SHAPES: Mapping[str, Callable[[np.random.Generator, int], Danger]] = {
    shape.__name__: shape
    for shape in (plane, union, intersection, convex, concave, corner, interplay)
}


def traffic_of(rng: np.random.Generator, d: int) -> TrafficModel:
    """A truncated mixture: correlated components, every third variable bounded on some side."""
    k = int(rng.integers(1, 5))
    mixed = rng.normal(size=(k, d, d)) * 0.4 + np.eye(d)
    covariances = mixed @ mixed.transpose(0, 2, 1) * rng.uniform(0.3, 1.5, (k, 1, 1))
    means = rng.normal(0.0, 1.0, (k, d))
    spread = np.sqrt(np.einsum("kii->ki", covariances).max(axis=0))
    bounded = rng.random((2, d)) < 0.3
    lower = np.where(bounded[0], means.min(axis=0) - rng.uniform(0.0, 2.0, d) * spread, -np.inf)
    upper = np.where(bounded[1], means.max(axis=0) + rng.uniform(2.0, 4.0, d) * spread, np.inf)
    names = tuple(f"x{i + 1}" for i in range(d))
    return TrafficModel(rng.dirichlet(np.full(k, 2.0)), means, covariances, lower, upper, names)


def problem(seed: int) -> tuple[str, Benchmark]:
    """The shape and the problem of a seed, with its reference."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(7,)))
    d, shape = int(rng.integers(2, 7)), list(SHAPES)[seed % len(SHAPES)]
    traffic, sign = traffic_of(rng, d), rng.choice([-1.0, 1.0], d)
    ordinary = traffic.sample(20_000, rng)
    center, scale = ordinary.mean(axis=0), ordinary.std(axis=0)
    danger, wanted = SHAPES[shape](rng, d), 10 ** rng.uniform(-8, -2)

    def danger_of(x: Rows) -> Rows:
        return danger(sign * (x - center) / scale)

    level, probability = reference(traffic, danger_of, wanted, rng)

    def crash(x: Rows) -> Outcomes:
        return danger_of(x) >= level

    risk = order_of(traffic, *("increasing" if s > 0 else "decreasing" for s in sign))
    return shape, Benchmark(traffic, risk, crash, probability)


def reference(
    traffic: TrafficModel, danger: Danger, wanted: float, rng: np.random.Generator
) -> tuple[float, float]:
    """A level that danger exceeds with about the probability `wanted`, and that probability.

    The level is found by importance sampling that follows it, a few thousand equally weighted draws
    beyond it at a time; it is then fixed, and a proposal fitted to the set beyond it drawn from
    until a standard error of half a per cent.
    """
    k, d = traffic.means.shape
    factors = np.repeat([1.0, 3.0, 9.0, 20.0], k)
    wide = Gaussians(
        np.full(4 * k, 1 / (4 * k)),
        np.tile(traffic.component_means, (4, 1)),
        np.tile(traffic.covariances, (4, 1, 1)) * factors[:, None, None],
    )
    proposal, told = wide, 0
    for _ in range(MOST_LEVELS):
        x, w = _weighted(traffic, proposal, 300_000, rng)
        order = np.argsort(-danger(x))
        beyond = int(np.searchsorted(np.cumsum(w[order]) / len(w), wanted)) + 1
        n_eff = np.cumsum(w[order]) ** 2 / np.maximum(np.cumsum(w[order] ** 2), 1e-300)
        enough = int(np.argmax(n_eff >= ENOUGH)) + 1 if n_eff.max() >= ENOUGH else len(x)
        inside = order[: max(beyond, enough)]
        level = float(danger(x[inside[-1:]])[0])
        picked = rng.choice(inside, 10_000, p=w[inside] / w[inside].sum())
        fitted = fit_gaussians(x[picked], 8, rng)
        proposal = _mixed((0.7, fitted, 1.2), (0.15, fitted, 6.0), (0.15, wide, 1.0))
        told += beyond >= enough
        if told == LEVELS_TOLD:
            break
    else:
        raise RuntimeError(f"no level in {d} variables whose probability is about {wanted:.3g}")
    total, squares, n = 0.0, 0.0, 0
    for _ in range(MOST_DRAWS):
        x, w = _weighted(traffic, proposal, 500_000, rng)
        part = w * (danger(x) >= level)
        total, squares, n = total + part.sum(), squares + part @ part, n + len(x)
        mean = total / n
        if math.sqrt((squares / n - mean**2) / n) <= PRECISE * mean:
            return level, float(mean)
    raise RuntimeError(f"no precise reference: p about {mean:.3g} in {d} variables")


def _weighted(
    traffic: TrafficModel, proposal: Gaussians, n: int, rng: np.random.Generator
) -> tuple[Rows, Rows]:
    """Draws (n, d) of a proposal and their weights; 0 outside the traffic model's box."""
    x = proposal.sample(n, rng)
    w, inside = np.zeros(n), traffic.contains(x)
    w[inside] = np.exp(traffic.log_density(x[inside]) - proposal.log_density(x[inside]))
    return x, w


def _mixed(*parts: tuple[float, Gaussians, float]) -> Gaussians:
    """A mixture of mixtures: share, mixture, and what its covariances are multiplied by."""
    return Gaussians(
        np.concatenate([share * g.weights for share, g, _ in parts]),
        np.concatenate([g.means for _, g, _ in parts]),
        np.concatenate([factor * g.covariances for _, g, factor in parts]),
    )


def run_seed(task: Record) -> Record:
    """One campaign, as a line of the study."""
    shape, p = problem(task["seed"])
    start = time.process_time()
    got = crashrate.estimate(
        p.crash,
        p.traffic,
        risk=p.risk if task["ordered"] else None,
        seed=task["seed"],
        relative_half_width=task["target"],
        max_calls=task["max_calls"],
    )
    low, high = got.interval
    return task | {
        "shape": shape,
        "d": p.traffic.n_variables,
        "reference": p.probability,
        "calls": got.n_calls,
        "probability": got.probability,
        "interval": [low, high],
        "covered": low <= p.probability <= high,
        "stop": got.stop_reason.name,
        "alarms": [alarm.name for alarm in got.alarms],
        "seconds": time.process_time() - start,
    }


def _progress(r: Record) -> str:
    held = "covered" if r["covered"] else "MISSED"
    answer = f"{r['probability'] / r['reference']:.3f} of {r['reference']:.2g}"
    told = " ".join(r["alarms"])
    return (
        f"seed {r['seed']}: {r['shape']}, d = {r['d']}: {r['calls']} calls, {answer}, {held} {told}"
    )


def table(records: list[Record]) -> str:
    """By shape and by number of variables: calls, coverage, errors of those that met the target."""
    lines = [
        "| problems | n | median calls | covered | of them, no alarm but NO_ORDER | bias |",
        "|---|---|---|---|---|---|",
    ]
    groups = [(shape, "shape") for shape in SHAPES] + [(d, "d") for d in range(2, 7)]
    for value, key in groups:
        lines += _row(f"{key} {value}", [r for r in records if r[key] == value])
    return "\n".join(lines + _row("all", records))


def _row(name: str, records: list[Record]) -> list[str]:
    if not records:
        return []
    n, held = len(records), sum(r["covered"] for r in records)
    low, high = clopper_pearson(held, n)
    silent = [r for r in records if not set(r["alarms"]) - {"NO_ORDER"}]
    kept = sum(r["covered"] for r in silent)
    met = [r["probability"] / r["reference"] - 1 for r in records if r["stop"] == "TARGET_MET"]
    bias = "–"
    if len(met) > 1:
        mean, error = statistics.mean(met), statistics.stdev(met) / len(met) ** 0.5
        bias = f"{100 * mean:+.1f} ± {100 * error:.1f} %"
    calls = statistics.median(r["calls"] for r in records)
    covered = f"{held} ({100 * low:.0f}–{100 * high:.0f} %)"
    return [f"| {name} | {n} | {calls:g} | {covered} | {kept} of {len(silent)} | {bias} |"]


def main() -> None:
    """Run the study named on the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=seeds, default=range(100), help="first:last+1")
    parser.add_argument("--out", type=Path, required=True, help="JSON lines, appended to")
    parser.add_argument("--unordered", action="store_true", help="declare no risk order")
    parser.add_argument("--target", type=float, default=0.1, help="relative half-width")
    parser.add_argument("--max-calls", type=int, default=1000, help="budget of each campaign")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    args = parser.parse_args()
    mend(args.out)
    fixed = {
        "ordered": not args.unordered,
        "target": args.target,
        "max_calls": args.max_calls,
        "version": crashrate.__version__,
    }
    tasks = [{"seed": seed} | fixed for seed in args.seeds]
    study(run_seed, without(tasks, read(args.out), KEYS), args.out, args.processes, _progress)
    by_order = itertools.groupby(
        sorted(read(args.out), key=lambda r: r["ordered"]), lambda r: r["ordered"]
    )
    for ordered, records in by_order:
        print("with a risk order" if ordered else "without a risk order", end="\n\n")
        print(table(list(records)), end="\n\n")


if __name__ == "__main__":
    main()
