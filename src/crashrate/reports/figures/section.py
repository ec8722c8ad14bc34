"""Sections of the learned set: what is implied to crash, implied safe, and undecided."""

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np

from crashrate.crash_set.monotone_set import Label
from crashrate.reports.figures.style import (
    CRASH,
    CRASH_FILL,
    INK,
    SAFE,
    SAFE_FILL,
    UNDECIDED_FILL,
    axis,
    figure,
)
from crashrate.reports.learned import Learned
from crashrate.reports.numbers import plain
from crashrate.reports.panel import Plot
from crashrate.variables import BoolArray, FloatArray

_GRID_SIZE = 140
NEAR = 0.03  # of the view: runs this close to the section are drawn on it
_WORDS = {Label.UNDECIDED: "undecided", Label.SAFE: "implied safe", Label.CRASH: "implied crash"}
_NAME = {"showarrow": False, "font": {"color": INK}, "bgcolor": "rgba(255,255,255,0.65)"}
_MARGIN = {"l": 64, "r": 18, "t": 36, "b": 48}
_LETTERING = (1.0, 0.25)  # a name is four times as wide as it is high
_MIN_CLEARANCE = 5  # grid cells above and below a region's name


def section_plots(learned: Learned) -> tuple[Plot, ...]:
    """A section for each pair of the coordinates drawn, through the reference point."""
    at = learned.axes_to_draw()
    return tuple(section_plot(learned, i, j) for i, j in combinations(at, 2))


def slice_text(learned: Learned, i: int, j: int) -> str:
    """Where the other coordinates are held, such as ``"v_lead = 12.3 m/s"``."""
    values = learned.physical(learned.reference[None])[0]
    others = [k for k in range(len(learned.axes)) if k not in (i, j)]
    texts = (
        f"{learned.axes[k].name} = {plain(values[k], 3)} {learned.axes[k].unit}" for k in others
    )
    return ", ".join(t.strip() for t in texts)


def section_plot(
    learned: Learned, i: int, j: int, marks: Sequence[Any] = (), **layout: Any
) -> Plot:
    """The section in coordinates i and j, with more traces `marks` on it."""
    first, second = learned.axes[i], learned.axes[j]
    labels = _labels(learned, i, j)
    held = slice_text(learned, i, j)
    plot = figure(
        [_regions(learned, i, j, labels), *_runs(learned, i, j), *marks],
        xaxis=axis(first.label, range=list(learned.limits(i)), nticks=5),
        yaxis=axis(second.label, range=list(learned.limits(j))),
        annotations=_names(learned, i, j, labels),
        title={"text": f"at {held}" if held else "", "font": {"size": 13}, "x": 0.5, "y": 0.97},
        **{"height": 360, "showlegend": False, "margin": _MARGIN, **layout},
    )
    where = f" at {held}" if held else ""
    return Plot(
        plot,
        f"Section of the learned set in {first.name} and {second.name}{where}: regions implied "
        "to crash, undecided and implied safe, and the simulator runs close to it.",
    )


def _grid(learned: Learned, k: int) -> FloatArray:
    """Cell centres in u, so that they ascend in physical units."""
    low, high = learned.limits(k)
    edges = np.linspace(low, high, _GRID_SIZE + 1)
    return np.asarray(learned.signs[k] * (edges[1:] + edges[:-1]) / 2)


def _labels(learned: Learned, i: int, j: int) -> np.ndarray:
    """(rows over u_j, columns over u_i) of `Label` values."""
    a, b = np.meshgrid(_grid(learned, i), _grid(learned, j))
    u = np.tile(learned.reference, (a.size, 1))
    u[:, i], u[:, j] = a.ravel(), b.ravel()
    return learned.monotone.classify(u).reshape(a.shape)


def _regions(learned: Learned, i: int, j: int, labels: np.ndarray) -> dict[str, Any]:
    third = 1 / 3
    return {
        "type": "heatmap",
        "x": learned.signs[i] * _grid(learned, i),
        "y": learned.signs[j] * _grid(learned, j),
        "z": labels.astype(np.int8),
        "zmin": -1,
        "zmax": 1,
        "colorscale": [
            [0, UNDECIDED_FILL],
            [third, UNDECIDED_FILL],
            [third, SAFE_FILL],
            [2 * third, SAFE_FILL],
            [2 * third, CRASH_FILL],
            [1, CRASH_FILL],
        ],
        "showscale": False,
        "hoverinfo": "skip",
    }


def _names(learned: Learned, i: int, j: int, labels: np.ndarray) -> list[dict[str, Any]]:
    """Each region's name, written where the region is widest: not colour alone."""
    from scipy.ndimage import distance_transform_edt

    notes = []
    for label, word in _WORDS.items():
        depth = distance_transform_edt(np.pad(labels == label, 1), sampling=_LETTERING)[1:-1, 1:-1]
        row, column = np.unravel_index(int(depth.argmax()), depth.shape)
        if depth[row, column] < _MIN_CLEARANCE:
            continue
        x = learned.signs[i] * _grid(learned, i)[column]
        y = learned.signs[j] * _grid(learned, j)[row]
        notes.append({"x": x, "y": y, "text": word, **_NAME})
    return notes


def near_section(learned: Learned, i: int, j: int) -> BoolArray:
    """Which runs lie so close to the section that it shows them."""
    others = [k for k in range(len(learned.axes)) if k not in (i, j)]
    width = NEAR * (learned.upper - learned.lower)
    off = np.abs(learned.u - learned.reference)[:, others]
    return np.asarray((off <= width[others]).all(axis=1))


def _runs(learned: Learned, i: int, j: int) -> list[dict[str, Any]]:
    near = near_section(learned, i, j)
    physical = learned.physical(learned.u)[:, [i, j]]
    kinds: Sequence[tuple[str, BoolArray, str, str]] = (
        ("run: crash", learned.outcomes == 1, CRASH, "x"),
        ("run: safe", learned.outcomes == 0, SAFE, "circle-open"),
        ("run: failed", np.isnan(learned.outcomes), INK, "cross"),
    )
    names = learned.axes[i].name, learned.axes[j].name
    return [
        {
            "type": "scatter",
            "x": physical[near & kind, 0],
            "y": physical[near & kind, 1],
            "mode": "markers",
            "name": name,
            "marker": {
                "color": color,
                "symbol": symbol,
                "size": 8,
                "line": {"width": 1.5, "color": color},
            },
            "hovertemplate": f"{name}<br>{names[0]} = %{{x:.4g}}<br>{names[1]} = %{{y:.4g}}"
            "<extra></extra>",
        }
        for name, kind, color, symbol in kinds
        if (near & kind).any()
    ]
