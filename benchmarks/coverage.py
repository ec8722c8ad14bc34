"""How often the interval holds the truth: a method over many seeds.

    python benchmarks/coverage.py --problem A --seeds 0:20 --out results.jsonl
    python benchmarks/coverage.py --problem A B C --batch-size 1 10 100 1000 --out batches.jsonl
    python benchmarks/coverage.py --problem A --target 0.2 0.1 0.05 --out targets.jsonl

Each seed is one line of JSON in the file; seeds already there are not run again, so that a study
can be stopped and taken up. The last thing printed is a table in Markdown, and a second one where
there are several batch sizes.
"""

import argparse
import itertools
import os
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one thread a process; read by numpy's import

import crashrate
from coverage_table import DEFAULT_BATCH, by_batch_size, table
from problems import PROBLEMS
from study import Record, mend, read, seeds, study, without

KEYS = ("problem", "method", "target", "max_calls", "batch_size", "version", "seed")


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
        batch_size=task["batch_size"],
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
    reference = record["reference"]
    answer = (
        f"{record['probability'] / reference:.4f} of the reference"
        if reference
        else (f"an upper end of {record['interval'][1]:.2g}")
    )
    covered = "covered" if record["covered"] else "NOT COVERED"
    return (
        f"{record['problem']} seed {record['seed']}: {record['calls']} calls, "
        f"{answer}, {covered}, {record['stop']}, {record['seconds']:.1f} s"
    )


def lines(path: Path) -> list[Record]:
    """The lines of a study so far; those from before batch sizes were recorded had the default."""
    return [{"batch_size": DEFAULT_BATCH} | record for record in read(path)]


def wanted(options: argparse.Namespace) -> list[Record]:
    """The campaigns asked for: every problem, target, batch size and seed."""
    chosen = (options.problem, options.target, options.batch_size, options.seeds)
    return [
        {
            "problem": name,
            "seed": seed,
            "method": options.method,
            "target": target,
            "max_calls": options.max_calls,
            "batch_size": batch_size,
            "version": crashrate.__version__,
        }
        for name, target, batch_size, seed in itertools.product(*chosen)
    ]


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--problem", nargs="+", choices=PROBLEMS, default=[], metavar="NAME")
    add("--seeds", type=seeds, default=range(20), help="first:last+1")
    add("--out", type=Path, required=True, help="JSON lines, appended to")
    add("--method", default="sequential")
    add("--target", type=float, nargs="+", default=[0.1], help="relative half-widths")
    add("--max-calls", type=int, default=2000)
    add(
        "--batch-size", type=int, nargs="+", default=[DEFAULT_BATCH], help="calls asked for at once"
    )
    add("--processes", type=int, default=1)
    return parser.parse_args()


def main() -> None:
    options = arguments()
    mend(options.out)
    missing = without(wanted(options), lines(options.out), KEYS)
    study(run_seed, missing, options.out, options.processes, _progress)
    records = lines(options.out)
    print(table(records))
    if len({record["batch_size"] for record in records}) > 1:
        print("\n" + by_batch_size(records))


if __name__ == "__main__":
    main()
