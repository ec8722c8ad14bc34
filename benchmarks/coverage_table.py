"""What the table of a coverage study says: a problem over its seeds, and calls by batch size."""

import math
import statistics
from collections.abc import Callable, Iterable, Sequence

from study import Record, clopper_pearson

HEAD = (
    "| problem | calls, median [min–max] | covered | 95 % interval of coverage | bias ± se "
    "| rmse | target met | own seconds a run |\n|---|---|---|---|---|---|---|---|"
)
DEFAULT_BATCH = 10


def row(name: str, records: Sequence[Record]) -> str:
    """One row of the table: a problem over its seeds."""
    n = len(records)
    calls = [r["calls"] for r in records]
    covered = sum(r["covered"] for r in records)
    low, high = clopper_pearson(covered, n)
    met = sum(r["stop"] == "TARGET_MET" for r in records)
    return (
        f"| {name} | {statistics.median(calls):g} [{min(calls)}–{max(calls)}] | {covered}/{n} "
        f"| {100 * low:.0f}–{100 * high:.0f} % | {_errors(records)} "
        f"| {met}/{n} | {statistics.fmean(r['seconds'] for r in records):.1f} |"
    )


def _errors(records: Sequence[Record]) -> str:
    """Bias and rmse; of what never happens, where the upper end of the interval is."""
    if not records[0]["reference"]:
        upper = statistics.median(r["interval"][1] for r in records)
        return f"upper end {upper:.2g} | –"
    errors = [r["probability"] / r["reference"] - 1 for r in records]
    missing = sum(map(math.isnan, errors))
    errors = [e for e in errors if not math.isnan(e)]
    note = f" ({missing} without an estimate)" if missing else ""
    if not errors:
        return f"–{note} | –"
    error = statistics.stdev(errors) / math.sqrt(len(errors)) if len(errors) > 1 else math.nan
    rmse = math.sqrt(statistics.fmean(e * e for e in errors))
    return f"{100 * statistics.fmean(errors):+.1f} ± {100 * error:.1f} %{note} | {100 * rmse:.1f} %"


def table(records: Iterable[Record]) -> str:
    """The study as a Markdown table, one row for each problem, target, method and batch size."""
    groups = _grouped(records, _label)
    return "\n".join([HEAD, *(row(name, groups[name]) for name in sorted(groups))])


def _label(record: Record) -> str:
    label = f"{record['problem']}, ± {100 * record['target']:g} %"
    if record["method"] != "sequential":
        label += f", {record['method']}"
    if record["batch_size"] != DEFAULT_BATCH:
        label += f", batches of {record['batch_size']:,}"
    return label


def by_batch_size(records: Sequence[Record]) -> str:
    """Median calls and covered seeds, a row for each problem and a column for each batch size."""
    sizes = sorted({r["batch_size"] for r in records})
    groups = _grouped(records, lambda r: _label(r | {"batch_size": DEFAULT_BATCH}))
    head = " | ".join(["| calls (covered) by batch size", *(f"{size:,}" for size in sizes)])
    rows = [
        " | ".join([f"| {name}", *(_calls(groups[name], size) for size in sizes)]) + " |"
        for name in sorted(groups)
    ]
    return "\n".join([head + " |", "|---" * (len(sizes) + 1) + "|", *rows])


def _calls(records: Sequence[Record], size: int) -> str:
    chosen = [r for r in records if r["batch_size"] == size]
    if not chosen:
        return "–"
    covered = sum(r["covered"] for r in chosen)
    return f"{statistics.median(r['calls'] for r in chosen):g} ({covered}/{len(chosen)})"


def _grouped(records: Iterable[Record], key: Callable[[Record], str]) -> dict[str, list[Record]]:
    groups: dict[str, list[Record]] = {}
    for record in records:
        groups.setdefault(key(record), []).append(record)
    return groups
