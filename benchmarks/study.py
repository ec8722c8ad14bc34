"""A study of many runs: one line of JSON each, in a file that can be taken up where it ended."""

import json
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from scipy.stats import beta

Record = dict[str, Any]


def read(path: Path) -> list[Record]:
    """The lines of a study so far."""
    if not path.exists():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def write(path: Path, records: Sequence[Record]) -> None:
    """Replace a study's lines by `records`."""
    path.write_text("".join(json.dumps(record) + "\n" for record in records), encoding="utf-8")


def mend(path: Path) -> None:
    """Remove a last line that an interruption cut short."""
    if path.exists():
        text = path.read_text(encoding="utf-8")
        path.write_text(text[: text.rfind("\n") + 1], encoding="utf-8")


def without(
    tasks: Sequence[Record], records: Sequence[Record], keys: Sequence[str]
) -> list[Record]:
    """The tasks of which no record has the same values of `keys`."""
    done = [{key: record[key] for key in keys} for record in records]
    return [task for task in tasks if {key: task[key] for key in keys} not in done]


def study(
    run: Callable[[Record], Record],
    tasks: Sequence[Record],
    path: Path,
    processes: int,
    progress: Callable[[Record], str],
) -> None:
    """Run the tasks, one line each as they end."""
    with path.open("a", encoding="utf-8") as out, ProcessPoolExecutor(processes) as pool:
        for done in as_completed([pool.submit(run, task) for task in tasks]):
            record = done.result()
            out.write(json.dumps(record) + "\n")
            out.flush()
            print(progress(record), file=sys.stderr)


def clopper_pearson(k: int, n: int, confidence: float = 0.95) -> tuple[float, float]:
    """Exact interval for a probability of which `k` of `n` trials succeeded."""
    tail = (1 - confidence) / 2
    low = float(beta.ppf(tail, k, n - k + 1)) if k else 0.0
    high = float(beta.ppf(1 - tail, k + 1, n - k)) if k < n else 1.0
    return low, high


def seeds(text: str) -> range:
    """``0:20`` or ``7``."""
    first, _, last = text.partition(":")
    return range(int(first), int(last) if last else int(first) + 1)
