"""The figure of `calls.py`: half-width against calls, every method, every problem."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl

from calls_table import half_width, names
from study import Record

COLUMNS = 3
MARKERS = "osD^v<>phXP*d"


def plot(records: Sequence[Record], path: Path) -> None:
    """One panel a problem, one point a run: filled where the interval covers, hollow where not."""
    mpl.use("Agg")
    mpl.rcParams.update({"svg.hashsalt": "calls", "font.size": 8, "svg.fonttype": "none"})
    from matplotlib import pyplot as plt

    problems, methods = names(records, "problem"), names(records, "method")
    n_rows = -(-(len(problems) + 1) // COLUMNS)  # the legend has a place of its own
    figure, axes = plt.subplots(
        n_rows, COLUMNS, figsize=(10, 2.9 * n_rows), sharex=True, sharey=True, squeeze=False
    )
    for problem, panel in zip(problems, axes.flat, strict=False):
        _panel(panel, [r for r in records if r["problem"] == problem], methods)
        panel.set_title(problem)
    for panel in axes.flat[len(problems) :]:
        panel.set_axis_off()
    handles, labels = _legend(axes.flat[0], methods)
    axes.flat[len(problems)].legend(handles, labels, loc="center left", frameon=False)
    figure.supxlabel("simulator calls")
    figure.supylabel("half-width of the 95 % interval over the estimate")
    figure.tight_layout()
    figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None, dpi=150)
    plt.close(figure)


def _style(methods: Sequence[str], method: str) -> tuple[str, str]:
    i = methods.index(method)
    return f"C{i % 10}", MARKERS[i % len(MARKERS)]


def _panel(panel: "mpl.axes.Axes", records: Sequence[Record], methods: Sequence[str]) -> None:
    for record in records:
        if record["error"]:
            continue
        color, marker = _style(methods, record["method"])
        face = color if record["covered"] else "none"
        x, y = record["calls"], half_width(record)
        panel.plot(x, y, marker, color=color, markerfacecolor=face, markersize=5)
    panel.set(xscale="log", yscale="log")
    panel.axhline(0.1, color="0.7", linewidth=0.6, zorder=0)
    panel.grid(visible=True, which="major", color="0.92", linewidth=0.5)


def _legend(panel: "mpl.axes.Axes", methods: Sequence[str]) -> tuple[list, list[str]]:
    handles = []
    for method in methods:
        color, marker = _style(methods, method)
        handles += panel.plot([], [], marker, color=color)
    handles += panel.plot([], [], "o", color="0.4", markerfacecolor="none")
    return handles, [*methods, "hollow: the interval does not cover"]
