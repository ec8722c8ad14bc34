"""How close goal="bounds" brings P(outer) and P(inner), and whether they hold the truth.

    python benchmarks/bounds.py --problem A B C --seeds 0:5 --max-calls 100 300

Prints a table in Markdown; nothing is stored. The target is out of reach, so that all runs go in.
"""

import argparse
import os
import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one thread a process; read by numpy's import

import crashrate
from coverage import seeds
from problems import PROBLEMS

TARGET = 1e-3
HEAD = (
    "| problem | runs | P(inner) / p | P(outer) / p | P(outer) / P(inner) | hold | contradicted "
    "| audits wrong | own seconds a run |\n|---|---|---|---|---|---|---|---|---|"
)


@dataclass(frozen=True)
class Bracket:
    """One campaign: its bounds over the reference, and what it says of the order."""

    inner: float
    outer: float
    contradicted: bool
    audits: tuple[int, int]
    seconds: float

    @property
    def holds(self) -> bool:
        """Whether the truth lies between."""
        return self.inner <= 1 <= self.outer


def campaign(name: str, seed: int, max_calls: int) -> Bracket:
    """One campaign for bounds."""
    problem, start = PROBLEMS[name](), time.process_time()
    got = crashrate.estimate(
        problem.crash,
        problem.traffic,
        risk=problem.risk,
        seed=seed,
        goal="bounds",
        relative_half_width=TARGET,
        max_calls=max_calls,
    )
    a = got.order_audit
    audits = (0, 0) if a is None else (a.n_crash_wrong + a.n_safe_wrong, a.n_crash + a.n_safe)
    return Bracket(
        got.bounds[0] / problem.probability,
        got.bounds[1] / problem.probability,
        any(alarm.name in {"ORDER_CONTRADICTED", "ORDER_DROPPED"} for alarm in got.alarms),
        audits,
        time.process_time() - start,
    )


def row(name: str, max_calls: int, found: Sequence[Bracket]) -> str:
    """One row of the table: a problem over its seeds."""
    n = len(found)
    wrong, audits = (sum(b.audits[i] for b in found) for i in (0, 1))
    return (
        f"| {name} | {max_calls} | {spread([b.inner for b in found])} "
        f"| {spread([b.outer for b in found])} "
        f"| {spread([b.outer / b.inner if b.inner else float('inf') for b in found])} "
        f"| {sum(b.holds for b in found)}/{n} | {sum(b.contradicted for b in found)}/{n} "
        f"| {wrong} of {audits} | {statistics.fmean(b.seconds for b in found):.1f} |"
    )


def spread(values: Sequence[float]) -> str:
    """Median and range."""
    return f"{statistics.median(values):.3g} [{min(values):.3g}–{max(values):.3g}]"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--problem", nargs="+", choices=PROBLEMS, required=True, metavar="NAME")
    parser.add_argument("--seeds", type=seeds, default=range(5), help="first:last+1")
    parser.add_argument("--max-calls", type=int, nargs="+", default=[100, 300])
    options = parser.parse_args()
    print(HEAD, flush=True)
    for name in options.problem:
        for max_calls in options.max_calls:
            found = [campaign(name, seed, max_calls) for seed in options.seeds]
            print(row(name, max_calls, found), flush=True)


if __name__ == "__main__":
    main()
