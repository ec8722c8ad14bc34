"""The table of `calls.py`: a row for every method, a column for every problem."""

import math
import statistics
from collections.abc import Sequence

from study import Record

CAPTION = """Each cell: median simulator calls; median relative half-width of the 95 % interval;
bias / relative RMSE in %; runs whose interval covers, of all runs. A run that raised, met its
limit of calls or seconds, or answered 0 is one without an estimate. crashrate is given outcomes
only, crash or not; the peers are given a continuous margin, an exact transform to standard
normals and the best settings found for them, except where their row says outcomes."""


def half_width(record: Record) -> float:
    """Half the interval over the estimate."""
    low, high = record["interval"]
    return float((high - low) / 2 / record["probability"])


def cell(records: Sequence[Record]) -> str:
    """A method on a problem over its seeds."""
    answered = [r for r in records if not r["error"]]
    failed = len(records) - len(answered)
    covers = f"{sum(r['covered'] for r in records)}/{len(records)}"
    if not answered:
        return f"{statistics.median(r['calls'] for r in records):,.0f}; no estimate; {covers}"
    errors = [r["probability"] / r["reference"] - 1 for r in answered]
    rmse = math.sqrt(statistics.fmean(e * e for e in errors))
    parts = [
        f"{statistics.median(r['calls'] for r in records):,.0f}",
        f"± {100 * statistics.median(map(half_width, answered)):.0f} %",
        f"{100 * statistics.fmean(errors):+.0f} / {100 * rmse:.0f}".replace("-", "\N{MINUS SIGN}"),
        covers,
    ]
    return "; ".join(parts) + (f" ({failed} without an estimate)" if failed else "")


def names(records: Sequence[Record], key: str) -> list[str]:
    """Values of `key`, in order of appearance, crashrate's first."""
    found = list(dict.fromkeys(record[key] for record in records))
    return sorted(found, key=lambda name: not name.startswith("crashrate"))


def table(records: Sequence[Record]) -> str:
    """The study in Markdown."""
    problems, rows = names(records, "problem"), []
    for method in names(records, "method"):
        of_method = [r for r in records if r["method"] == method]
        cells = [[r for r in of_method if r["problem"] == problem] for problem in problems]
        rows.append(f"| {method} | " + " | ".join(cell(c) if c else "–" for c in cells) + " |")
    head = f"| method | {' | '.join(problems)} |\n|---|{'---|' * len(problems)}"
    return "\n".join([CAPTION, "", head, *rows, "", f"Versions: {versions(records)}."])


def versions(records: Sequence[Record]) -> str:
    """Of the packages, as recorded."""
    return ", ".join(sorted({f"{r['package']} {r['version']}" for r in records}))
