"""Simulator calls: crashrate and other tools on the same problems, side by side.

    pip install -e '.[bench]'
    python benchmarks/calls.py --seeds 0:5 --out calls.jsonl --plot calls.svg
    python benchmarks/calls.py --table --out calls.jsonl --plot calls.svg    # no further runs

Calls are counted by the function that is called. crashrate is given the outcome of each call, crash
or not, and the risk order where the problem has one. The peers are given more: a continuous margin
and the exact transform to independent standard normals, with the settings of `peers/`.

Each run is one line of JSON in the file; runs already there are not run again, so that a study can
be stopped and taken up (`--again` runs the chosen ones anew). The last thing printed is a table in
Markdown; `--plot` draws half-width against calls.
"""

import argparse
import os
import sys
import time
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one thread a process; read by numpy's import

import peers
from calls_table import table
from crashrate.estimation.campaign import Campaign
from crashrate.estimation.methods import METHODS
from peers.limit_state import Answer, LimitState
from peers.limits import BudgetError, at_most
from problems import PROBLEMS, Benchmark, Outcomes, Rows
from study import Record, mend, read, seeds, study, without, write

DEFAULT_PROBLEMS = ("A", "B", "C", "D", "disc", "linear, d = 10", "random walk, d = 10")
KEYS = ("problem", "method", "seed", "settings", "package", "version")
OURS = "crashrate"


class CountedCrash:
    """The outcome of each row, and how many rows there were."""

    def __init__(self, problem: Benchmark) -> None:
        self._crash = problem.crash
        self.n_calls = 0

    def __call__(self, x: Rows) -> Outcomes:
        """Rows (n, d) to outcomes (n,)."""
        self.n_calls += len(x)
        return self._crash(x)


def ours(problem: Benchmark, task: Record) -> Record:
    """One campaign of crashrate: outcomes only."""
    crash, settings = CountedCrash(problem), task["settings"]
    campaign = Campaign(
        problem.traffic,
        risk=problem.risk,
        seed=task["seed"],
        method=task["method"].removeprefix(f"{OURS} "),
        relative_half_width=settings["target"],
        max_calls=settings["max_calls"],
    )
    try:
        with at_most(settings["max_seconds"]):
            while not campaign.done:
                campaign.tell(crash(campaign.ask()))
    except BudgetError as error:
        return {"calls": crash.n_calls} | _failed(str(error))
    got = campaign.estimate()
    notes = (got.stop_reason.name, *(alarm.name for alarm in got.alarms))
    answer = Answer(got.probability, *got.interval, notes)
    return {"calls": crash.n_calls} | _judged(answer, problem)


def theirs(problem: Benchmark, task: Record) -> Record:
    """One run of a peer; what it raises is a result of the study."""
    peer, settings = peers.available()[task["method"]], task["settings"]
    limit = LimitState(problem, max_calls=settings["max_calls"], binary=peer.binary)
    try:
        with at_most(settings["max_seconds"]):
            answer = peer.run(limit, task["seed"], peer.settings)
    except Exception as error:  # noqa: BLE001 -- whatever another tool raises on a problem
        return {"calls": limit.n_calls} | _failed(limit.ended or _in_a_line(error))
    if limit.ended:  # some tools swallow what their function raises
        return {"calls": limit.n_calls} | _failed(limit.ended)
    return {"calls": limit.n_calls} | _judged(answer.scaled(limit.factor), problem)


def _in_a_line(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())}"[:200]


def _failed(error: str) -> Record:
    return {"probability": None, "interval": None, "covered": False, "error": error}


def _judged(answer: Answer, problem: Benchmark) -> Record:
    """An answer beside the reference. An interval may hold it where no crash was found."""
    return {
        "probability": answer.probability,
        "interval": [answer.low, answer.high],
        "covered": answer.low <= problem.probability <= answer.high,
        "error": answer.complaint(),
        "notes": list(answer.notes),
    }


def run_task(task: Record) -> Record:
    """One run, as a line of the study."""
    problem = PROBLEMS[task["problem"]]()
    run = ours if task["package"] == OURS else theirs
    start = time.process_time()
    found = run(problem, task)
    seconds = round(time.process_time() - start, 2)
    return task | {"reference": problem.probability, "seconds": seconds} | found


def _progress(record: Record) -> str:
    found = record["error"]
    if not found:
        covered = "covered" if record["covered"] else "NOT COVERED"
        found = f"{record['probability'] / record['reference']:.3f} of the reference, {covered}"
    return (
        f"{record['problem']}, {record['method']}, seed {record['seed']}: {record['calls']:,} "
        f"calls, {found}, {record['seconds']:.1f} s"
    )


def methods(options: argparse.Namespace) -> dict[str, Record]:
    """Every method that can run here, with the part of its lines that is the same for all runs."""
    clock = {"max_seconds": options.max_seconds}
    own = {"target": options.target, "max_calls": options.max_calls} | clock
    caps = {"max_calls": options.peer_calls} | clock
    return {
        f"{OURS} {name}": {"settings": own, "package": OURS, "version": version(OURS)}
        for name in METHODS
    } | {
        name: {
            "settings": dict(peer.settings) | caps,
            "package": peer.package,
            "version": version(peer.package),
        }
        for name, peer in peers.available().items()
    }


def tasks(options: argparse.Namespace, known: Mapping[str, Record]) -> list[Record]:
    """The chosen runs, seed by seed, so that an interrupted study has some of everything."""
    without_margin = {name for name in options.problem if PROBLEMS[name]().margin is None}
    return [
        {"problem": problem, "method": method, "seed": seed} | known[method]
        for seed in options.seeds
        for problem in options.problem
        for method in options.method or known
        if problem not in without_margin or known[method]["package"] == OURS
    ]


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("--problem", nargs="+", choices=PROBLEMS, default=DEFAULT_PROBLEMS, metavar="NAME")
    add("--method", nargs="+", default=[], metavar="NAME", help="as in the table; all by default")
    add("--seeds", type=seeds, default=range(5), help="first:last+1")
    add("--out", type=Path, required=True, help="JSON lines, appended to")
    add("--table", action="store_true", help="only print the table of what the file holds")
    add("--plot", type=Path, help="draw half-width against calls here (.svg, .png)")
    add("--again", action="store_true", help="run the chosen ones anew")
    add("--target", type=float, default=0.1, help="relative half-width of crashrate's methods")
    add("--max-calls", type=int, default=2000, help="budget of crashrate's methods")
    add("--peer-calls", type=int, default=300_000, help="most calls of a peer")
    add("--max-seconds", type=float, default=300.0, help="process time after which a run ends")
    add("--processes", type=int, default=1)
    return parser.parse_args()


def run(options: argparse.Namespace) -> None:
    """What is chosen and not yet in the file."""
    for module, packages in peers.missing().items():
        print(
            f"calls: {module} is left out, {packages} is not installed; pip install -e '.[bench]'",
            file=sys.stderr,
        )
    known = methods(options)
    unknown = [name for name in options.method if name not in known]
    if unknown:
        sys.exit(f"--method: expected some of {', '.join(known)}; got {', '.join(unknown)}.")
    wanted = tasks(options, known)
    if options.again:
        write(options.out, without(read(options.out), wanted, ("problem", "method", "seed")))
    missing = without(wanted, read(options.out), KEYS)
    study(run_task, missing, options.out, options.processes, _progress)


def main() -> None:
    options = arguments()
    mend(options.out)
    if not options.table:
        run(options)
    records = read(options.out)
    if options.plot:
        from calls_plot import plot

        plot(records, options.plot)
    print(table(records))


if __name__ == "__main__":
    main()
