"""What a campaign itself costs, beside the simulator: seconds a round and memory as runs add up.

    python benchmarks/own_cost.py --problem C --calls 10000 --seconds 500
    python benchmarks/own_cost.py --problem D disc --batch-size 100 --seconds 120

One campaign for each problem, in a process of its own, with a target that it does not reach. A
round is one ask and one tell; process time, the simulator left out. Printed as a Markdown table,
each row when it is known; a campaign is given up after `--seconds` of its own, between rounds.
"""

import argparse
import math
import os
import resource
import sys
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing import get_context

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one thread a process; read by numpy's import

from crashrate.estimation.campaign import Campaign
from problems import PROBLEMS, Benchmark

CHECKPOINTS = (100, 300, 600, 1200, 2500, 5000, 10_000)
LATEST = 10  # "seconds a round" is the mean of so many rounds, or of all since the row before
PROBLEM_NAMES = ("C", "D", "disc")
HEAD = (
    "| problem | batch | simulator runs | seconds a round | grows as | longest round "
    "| own seconds in all | peak memory | half-width |\n|---|---|---|---|---|---|---|---|---|"
)


@dataclass(frozen=True)
class Round:
    """One ask and tell: simulator runs so far, and the campaign's own seconds in it."""

    n_calls: int
    seconds: float


@dataclass(frozen=True)
class Cost:
    """What a campaign has cost when it reached a checkpoint.

    Parameters
    ----------
    n_calls : int
    latest : float
        Seconds a round, mean of the latest rounds.
    longest : float
        Seconds of the longest round so far.
    total : float
        Seconds of all rounds so far.
    peak : float
        Largest resident memory of the process so far, MiB.
    half_width : float
        Relative half-width of the interval.
    """

    n_calls: int
    latest: float
    longest: float
    total: float
    peak: float
    half_width: float


def rounds(campaign: Campaign, problem: Benchmark) -> Iterator[Round]:
    """Run the campaign, timing it without the simulator."""
    while not campaign.done:
        asked = time.process_time()
        x = campaign.ask()
        seconds = time.process_time() - asked
        outcomes = problem.crash(x)
        told = time.process_time()
        campaign.tell(outcomes)
        yield Round(campaign.n_calls, seconds + time.process_time() - told)


def costs(campaign: Campaign, problem: Benchmark, limit: float) -> Iterator[Cost]:
    """What it has cost at each checkpoint, and where it ended or was given up."""
    latest: deque[float] = deque(maxlen=LATEST)
    left, total, longest = list(CHECKPOINTS), 0.0, 0.0
    for step in rounds(campaign, problem):
        total, longest = total + step.seconds, max(longest, step.seconds)
        if not campaign.done or not latest:  # the last tell also makes the final bounds
            latest.append(step.seconds)
        reached = bool(left) and step.n_calls >= left[0]
        if reached or campaign.done or total > limit:
            left = [n for n in left if n > step.n_calls]
            half_width = campaign.estimate().relative_half_width
            mean = sum(latest) / len(latest)
            latest.clear()
            yield Cost(step.n_calls, mean, longest, total, peak_memory(), half_width)
        if total > limit:
            return


def peak_memory() -> float:
    """Largest resident memory of this process so far, in MiB."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20


def exponent(before: Cost | None, now: Cost) -> str:
    """The power of n with which seconds a round grew since the checkpoint before."""
    if before is None or now.n_calls < 1.1 * before.n_calls:
        return "–"
    power = math.log(now.latest / before.latest) / math.log(now.n_calls / before.n_calls)
    return f"n^{power:.1f}".replace("-", "−")


def row(name: str, batch_size: int, before: Cost | None, now: Cost) -> str:
    """One row of the table."""
    return (
        f"| {name} | {batch_size} | {now.n_calls:,} | {now.latest:.2f} | {exponent(before, now)} "
        f"| {now.longest:.2f} | {now.total:.0f} | {now.peak:.0f} MiB | {_percent(now.half_width)} |"
    )


def _percent(half_width: float) -> str:
    return f"± {100 * half_width:.2g} %" if half_width < 1 else "–"


def measure(name: str, options: argparse.Namespace) -> None:
    """One campaign, printed row by row."""
    problem, before = PROBLEMS[name](), None
    campaign = Campaign(
        problem.traffic,
        risk=problem.risk,
        seed=options.seed,
        relative_half_width=options.target,
        max_calls=options.calls,
        batch_size=options.batch_size,
    )
    for cost in costs(campaign, problem, options.seconds):
        print(row(name, options.batch_size, before, cost), flush=True)
        before = cost


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--problem", nargs="+", choices=PROBLEMS, default=PROBLEM_NAMES, metavar="NAME")
    add("--calls", type=int, default=CHECKPOINTS[-1], help="simulator runs of a campaign")
    add("--batch-size", type=int, default=10)
    add("--target", type=float, default=0.001, help="relative half-width, out of reach")
    add("--seconds", type=float, default=math.inf, help="a campaign's own, then it is given up")
    add("--seed", type=int, default=0)
    return parser.parse_args()


def main() -> None:
    options = arguments()
    print(HEAD, flush=True)
    for name in options.problem:
        # a process each: peak memory is a process's, and only grows
        worker = get_context("spawn").Process(target=measure, args=(name, options))
        worker.start()
        worker.join()
        if worker.exitcode:
            raise SystemExit(f"own_cost: the campaign on {name} ended with {worker.exitcode}.")


if __name__ == "__main__":
    main()
