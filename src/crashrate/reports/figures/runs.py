"""The simulator runs alone: where no risk order says what they imply, or it has one coordinate."""

from itertools import combinations
from typing import Any

import numpy as np

from crashrate.crash_set.monotone_set import MonotoneSet
from crashrate.reports.axes import Axis, variable_axes
from crashrate.reports.figures.style import (
    CRASH,
    CRASH_FILL,
    INK,
    SAFE,
    SAFE_FILL,
    axis,
    figure,
    padded,
)
from crashrate.reports.learned import Learned
from crashrate.reports.panel import Plot
from crashrate.runs.record import RunRecord
from crashrate.variables import BoolArray, FloatArray

_MAX_VARIABLES = 4


def runs_plots(record: RunRecord) -> tuple[Plot, ...]:
    """The runs in every pair of (at most four) variables."""
    axes = variable_axes(record.scenario)[:_MAX_VARIABLES]
    if len(axes) == 1:
        return (_over_number(record.x[:, 0], record.outcomes, axes[0]),)
    return tuple(
        _plot(record.x[:, i], record.x[:, j], record.outcomes, axes[i].label, axes[j].label)
        for i, j in combinations(range(len(axes)), 2)
    )


def line_plot(learned: Learned) -> Plot:
    """The runs over the one risk coordinate, with what is implied as bands."""
    plot = _over_number(learned.physical(learned.u)[:, 0], learned.outcomes, learned.axes[0])
    plot.figure.update_layout(
        shapes=_bands(learned.monotone, learned.signs[0], plot.figure.layout.xaxis.range)
    )
    return plot


def _bands(s: MonotoneSet, sign: float, view: tuple[float, float]) -> list[dict[str, Any]]:
    half_lines = (
        (s.minimal_crashes[:, 0], CRASH_FILL, view[1 if sign > 0 else 0]),
        (s.maximal_safe[:, 0], SAFE_FILL, view[0 if sign > 0 else 1]),
    )
    return [
        {
            "type": "rect",
            "layer": "below",
            "yref": "paper",
            "y0": 0,
            "y1": 1,
            "x0": sign * ends[0],
            "x1": far,
            "fillcolor": fill,
            "line": {"width": 0},
        }
        for ends, fill, far in half_lines
        if len(ends)
    ]


def _over_number(values: FloatArray, outcomes: FloatArray, on: Axis) -> Plot:
    number = np.arange(1.0, len(values) + 1)
    return _plot(values, number, outcomes, on.label, "simulator run")


def _plot(x: FloatArray, y: FloatArray, outcomes: FloatArray, x_label: str, y_label: str) -> Plot:
    kinds: tuple[tuple[str, BoolArray, str, str], ...] = (
        ("run: safe", outcomes == 0, SAFE, "circle-open"),
        ("run: crash", outcomes == 1, CRASH, "x"),
        ("run: failed", np.isnan(outcomes), INK, "cross"),
    )
    traces = [
        {
            "type": "scatter",
            "x": x[kind],
            "y": y[kind],
            "mode": "markers",
            "name": name,
            "marker": {"color": color, "symbol": symbol, "size": 7},
            "hovertemplate": "%{x:.4g}, %{y:.4g}<extra></extra>",
        }
        for name, kind, color, symbol in kinds
        if kind.any()
    ]
    plot = figure(
        traces,
        height=360,
        showlegend=True,
        xaxis=axis(x_label, range=list(padded(x.min(), x.max())), nticks=5),
        yaxis=axis(y_label, range=list(padded(y.min(), y.max()))),
    )
    return Plot(plot, f"The simulator runs, crashes and safe ones, in {x_label} and {y_label}.")
