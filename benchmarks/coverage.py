"""How often the interval holds the truth: a method over many seeds.

    python benchmarks/coverage.py --problem A --seeds 0:20 --out results.jsonl

Each seed is one line of JSON in the file; seeds already there are not run again, so that a study
can be stopped and taken up. The last thing printed is a table in Markdown.
"""

import argparse
import math
import os
import statistics
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one thread a process; read by numpy's import

import crashrate
from problems import PROBLEMS
from study import Record, clopper_pearson, mend, read, seeds, study, without

KEYS = ("problem", "method", "target", "max_calls", "version", "seed")


def run_seed(task: Record) -> Record:
    """One campaign, as a line of the study."""
    problem = PROBLEMS[task["problem"]]()
    start = time.process_time()
    got = crashrate.estimate(
        problem.crash,
        problem.traffic,
        risk=problem.risk,
        seed=task["seed"],
        method=task["method"],
        relative_half_width=task["target"],
        max_calls=task["max_calls"],
    )
    low, high = got.interval
    return task | {
        "calls": got.n_calls,
        "probability": got.probability,
        "interval": [low, high],
        "reference": problem.probability,
        "covered": low <= problem.probability <= high,
        "bounds_hold": got.bounds[0] <= problem.probability <= got.bounds[1],
        "stop": got.stop_reason.name,
        "alarms": [alarm.name for alarm in got.alarms],
        "seconds": time.process_time() - start,
    }


def _progress(record: Record) -> str:
    ratio = record["probability"] / record["reference"]
    covered = "covered" if record["covered"] else "NOT COVERED"
    return (
        f"{record['problem']} seed {record['seed']}: {record['calls']} calls, "
        f"{ratio:.4f} of the reference, {covered}, {record['stop']}, {record['seconds']:.1f} s"
    )


HEAD = (
    "| problem | calls, median [min–max] | covered | 95 % interval of coverage | bias ± se "
    "| rmse | target met | own seconds a run |\n|---|---|---|---|---|---|---|---|"
)


def row(name: str, records: Sequence[Record]) -> str:
    """One row of the table: a problem over its seeds."""
    n = len(records)
    calls = [r["calls"] for r in records]
    errors = [r["probability"] / r["reference"] - 1 for r in records]
    covered = sum(r["covered"] for r in records)
    low, high = clopper_pearson(covered, n)
    error = statistics.stdev(errors) / math.sqrt(n) if n > 1 else math.nan
    rmse = math.sqrt(statistics.fmean(e * e for e in errors))
    met = sum(r["stop"] == "TARGET_MET" for r in records)
    return (
        f"| {name} | {statistics.median(calls):g} [{min(calls)}–{max(calls)}] | {covered}/{n} "
        f"| {100 * low:.0f}–{100 * high:.0f} % "
        f"| {100 * statistics.fmean(errors):+.1f} ± {100 * error:.1f} % | {100 * rmse:.1f} % "
        f"| {met}/{n} | {statistics.fmean(r['seconds'] for r in records):.1f} |"
    )


def table(records: Iterable[Record]) -> str:
    """The study as a Markdown table, one row for each problem."""
    groups: dict[str, list[Record]] = {}
    for record in records:
        label = f"{record['problem']}, ± {100 * record['target']:g} %"
        if record["method"] != "sequential":
            label += f", {record['method']}"
        groups.setdefault(label, []).append(record)
    return "\n".join([HEAD, *(row(name, groups[name]) for name in sorted(groups))])


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--problem", nargs="+", choices=PROBLEMS, default=[], metavar="NAME")
    parser.add_argument("--seeds", type=seeds, default=range(20), help="first:last+1")
    parser.add_argument("--out", type=Path, required=True, help="JSON lines, appended to")
    parser.add_argument("--method", default="sequential")
    parser.add_argument("--target", type=float, default=0.1, help="relative half-width")
    parser.add_argument("--max-calls", type=int, default=2000)
    parser.add_argument("--processes", type=int, default=1)
    return parser.parse_args()


def main() -> None:
    options = arguments()
    mend(options.out)
    wanted = [
        {
            "problem": name,
            "seed": seed,
            "method": options.method,
            "target": options.target,
            "max_calls": options.max_calls,
            "version": crashrate.__version__,
        }
        for name in options.problem
        for seed in options.seeds
    ]
    missing = without(wanted, read(options.out), KEYS)
    study(run_seed, missing, options.out, options.processes, _progress)
    print(table(read(options.out)))


if __name__ == "__main__":
    main()
