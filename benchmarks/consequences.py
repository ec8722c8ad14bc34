"""How often the intervals of an event's consequences hold the truth, over many seeds.

    python benchmarks/consequences.py --aim event depth --seeds 0:40 --out results.jsonl

The event is a half-space of two standard normals with probability 1e-6, s = (x1 + x2) / √2 > a.
Its consequences, all told by the same runs, have exact expectations: ``depth`` min((s - a) / 0.4,
1); ``severe`` and ``rare``, s beyond the quantiles of 1e-7 and 1e-8; ``side``, x1 > x2; ``chance``,
yes with probability 0.3 whatever x. Each seed is one line of JSON in the file; seeds already there
are not run again. The last thing printed is a table in Markdown.
"""

import argparse
import math
import os
import statistics
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one thread a process; read by numpy's import

import numpy as np
from scipy.integrate import quad
from scipy.stats import norm

import crashrate
from braking_follower import Rows
from problems import linear
from study import Record, clopper_pearson, mend, read, seeds, study, without

PROBABILITY, DEPTH, CHANCE = 1e-6, 0.4, 0.3
LEVEL, SEVERE, RARE = norm.isf([PROBABILITY, 1e-7, 1e-8])
EVENT = "event"
KEYS = ("aim", "target", "max_calls", "version", "seed")


def truths() -> Mapping[str, float]:
    """Exact expectations, the event's own first."""
    ramp, _ = quad(
        lambda s: (s - LEVEL) / DEPTH * norm.pdf(s), LEVEL, LEVEL + DEPTH, epsabs=0, epsrel=1e-10
    )
    return {
        EVENT: PROBABILITY,
        "depth": ramp + norm.sf(LEVEL + DEPTH),
        "severe": 1e-7,
        "rare": 1e-8,
        "side": PROBABILITY / 2,
        "chance": CHANCE * PROBABILITY,
    }


TRUTHS = truths()
NAMES = tuple(TRUTHS)[1:]


def simulator(seed: int) -> Callable[[Rows], Rows]:
    """Rows (n, 2) to the event and its consequences (n, 6), chance included."""
    rng = np.random.default_rng((seed, 1))

    def simulate(x: Rows) -> Rows:
        s = x.sum(axis=1) / math.sqrt(2)
        columns = (
            np.ones(len(x)),
            np.clip((s - LEVEL) / DEPTH, 0.0, 1.0),
            s > SEVERE,
            s > RARE,
            x[:, 0] > x[:, 1],
            rng.random(len(x)) < CHANCE,
        )
        return np.asarray((s > LEVEL)[:, None] * np.column_stack(columns))

    return simulate


def run_seed(task: Record) -> Record:
    """One campaign, as a line of the study."""
    problem = linear(2, PROBABILITY)
    start = time.process_time()
    got = crashrate.estimate(
        simulator(task["seed"]),
        problem.traffic,
        risk=problem.risk,
        seed=task["seed"],
        relative_half_width=task["target"],
        max_calls=task["max_calls"],
        consequences=NAMES,
        aim=None if task["aim"] == EVENT else task["aim"],
    )
    found = {c.name: [c.mean, *c.interval, c.determined] for c in got.consequences} | {
        EVENT: [got.probability, *got.interval, True]
    }
    return task | {
        "calls": got.n_calls,
        "found": found,
        "stop": got.stop_reason.name,
        "alarms": [alarm.name for alarm in got.alarms],
        "seconds": time.process_time() - start,
    }


def _progress(record: Record) -> str:
    missed = [
        name
        for name, (_, low, high, _) in record["found"].items()
        if not low <= TRUTHS[name] <= high
    ]
    return (
        f"aim {record['aim']} seed {record['seed']}: {record['calls']} calls, not covered: "
        f"{', '.join(missed) or 'none'}, {record['stop']}, {record['seconds']:.1f} s"
    )


HEAD = (
    "| aimed at | calls, median [min–max] | number | covered | 95 % interval of coverage "
    "| bias ± se | ± of the interval, median | not determined |\n|---|---|---|---|---|---|---|---|"
)


def row(aim: str, name: str, records: list[Record]) -> str:
    """One row of the table: a number over the seeds of one aim."""
    truth, n = TRUTHS[name], len(records)
    calls = [r["calls"] for r in records]
    found = [r["found"][name] for r in records]
    covered = sum(low <= truth <= high for _, low, high, _ in found)
    low, high = clopper_pearson(covered, n)
    errors = [mean / truth - 1 for mean, *_ in found]
    error = statistics.stdev(errors) / math.sqrt(n) if n > 1 else math.nan
    width = statistics.median((top - bottom) / 2 / truth for _, bottom, top, _ in found)
    return (
        f"| {aim} | {statistics.median(calls):g} [{min(calls)}–{max(calls)}] | {name} "
        f"| {covered}/{n} | {100 * low:.0f}–{100 * high:.0f} % "
        f"| {100 * statistics.fmean(errors):+.1f} ± {100 * error:.1f} % | {100 * width:.0f} % "
        f"| {sum(not determined for *_, determined in found)}/{n} |"
    )


def table(records: Iterable[Record]) -> str:
    """The study as a Markdown table."""
    groups: dict[str, list[Record]] = {}
    for record in records:
        groups.setdefault(f"{record['aim']}, ± {100 * record['target']:g} %", []).append(record)
    rows = [row(aim, name, groups[aim]) for aim in groups for name in TRUTHS]
    return "\n".join([HEAD, *rows])


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--aim", nargs="+", choices=TRUTHS, default=[], metavar="NAME")
    parser.add_argument("--seeds", type=seeds, default=range(40), help="first:last+1")
    parser.add_argument("--out", type=Path, required=True, help="JSON lines, appended to")
    parser.add_argument("--target", type=float, default=0.1, help="relative half-width")
    parser.add_argument("--max-calls", type=int, default=2000)
    parser.add_argument("--processes", type=int, default=1)
    return parser.parse_args()


def main() -> None:
    options = arguments()
    mend(options.out)
    wanted = [
        {
            "aim": aim,
            "seed": seed,
            "target": options.target,
            "max_calls": options.max_calls,
            "version": crashrate.__version__,
        }
        for aim in options.aim
        for seed in options.seeds
    ]
    missing = without(wanted, read(options.out), KEYS)
    study(run_seed, missing, options.out, options.processes, _progress)
    print(table(read(options.out)))


if __name__ == "__main__":
    main()
