"""The bias of whole campaigns, with less noise than their mean has.

    python benchmarks/bias.py --problem D --seeds 0:60 --out bias.jsonl

Each round's estimate less the crash mass of its own pool, and that mass less the probability, have
the mean 0 given the past. Their sums over a campaign are martingales, which a stopping rule leaves
at the mean 0; so what the campaign's answer owes to them is luck, and no bias. Regressed on them
the answers keep a mean with a third to a half of the standard error (control variates). The lines
of a study resume.
"""

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one thread a process; read by numpy's import

import numpy as np

import crashrate
from problems import PROBLEMS
from study import Record, mend, read, seeds, study, without
from unbiased import spied

if TYPE_CHECKING:
    from crashrate.estimation.rounds import Round
    from crashrate.estimation.view import View

KEYS = ("problem", "seed", "version")
HEAD = (
    "| problem | campaigns | bias, plain | luck, in standard errors | bias, by control variates "
    "| of the variance explained |\n|---|---|---|---|---|---|"
)


def run_seed(task: Record) -> Record:
    """One campaign: its answer, and the sums of its rounds' errors, over the reference."""
    problem = PROBLEMS[task["problem"]]()
    seed = task["seed"]
    seen: list[tuple[View, Round]] = []
    with spied(seen):
        got = crashrate.estimate(problem.crash, problem.traffic, risk=problem.risk, seed=seed)
    p = problem.probability
    mass = np.array([v.weights @ np.asarray(problem.crash(v.pool.x), float) for v, _ in seen]) / p
    estimates = np.array([r.estimate for _, r in seen]) / p
    precision = np.array([r.predicted**2 / r.variance for _, r in seen])
    errors = estimates - mass
    return task | {
        "ratio": got.probability / p,
        "calls": got.n_calls,
        "covered": got.interval[0] <= p <= got.interval[1],
        "sums": [float(errors.sum()), float(errors @ precision), float((mass - 1).sum())],
    }


def row(name: str, records: list[Record]) -> str:
    """One row of the table."""
    ratios = np.array([r["ratio"] for r in records]) - 1
    sums = np.array([r["sums"] for r in records])
    n, k = len(ratios), 1 + sums.shape[1]
    columns = np.column_stack([np.ones(n), sums / sums.std(axis=0)])
    solution = np.linalg.lstsq(columns, ratios, rcond=None)[0]
    left = ratios - columns @ solution
    error = np.sqrt(np.linalg.inv(columns.T @ columns)[0, 0] * (left @ left) / (n - k))
    luck = sums.mean(axis=0) / sums.std(axis=0, ddof=1) * np.sqrt(n)
    return (
        f"| {name} | {n} | {_percent(ratios.mean(), ratios.std(ddof=1) / np.sqrt(n))} "
        f"| {', '.join(f'{z:+.1f}' for z in luck)} | {_percent(solution[0], error)} "
        f"| {100 * (1 - left.var() / ratios.var()):.0f} % |"
    )


def _percent(value: float, error: float) -> str:
    return f"{100 * value:+.2f} ± {100 * error:.2f} %"


def _progress(record: Record) -> str:
    return "{problem} seed {seed}: {calls} calls, {ratio:.4f} of the reference".format(**record)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add: Any = parser.add_argument
    add("--problem", nargs="+", choices=PROBLEMS, required=True, metavar="NAME")
    add("--seeds", type=seeds, default=range(20), help="first:last+1")
    add("--out", type=Path, required=True, help="JSON lines, appended to")
    add("--processes", type=int, default=1)
    return parser.parse_args()


def main() -> None:
    options = arguments()
    version = crashrate.__version__
    tasks = [
        {"problem": name, "seed": seed, "version": version}
        for name in options.problem
        for seed in options.seeds
    ]
    mend(options.out)
    missing = without(tasks, read(options.out), KEYS)
    study(run_seed, missing, options.out, options.processes, _progress)
    print(HEAD, file=sys.stdout)
    for name in options.problem:
        print(row(name, [r for r in read(options.out) if r["problem"] == name]))


if __name__ == "__main__":
    main()
