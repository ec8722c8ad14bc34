"""The learned set in three dimensions, turnable, in physical risk coordinates."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from crashrate.reports.dominating import DominatingPoint
from crashrate.reports.figures.section import section_plot
from crashrate.reports.figures.style import (
    ACCENT,
    CRASH,
    GRID,
    INK,
    MUTED,
    SAFE,
    figure,
    plain_text,
)
from crashrate.reports.learned import Learned
from crashrate.reports.panel import Plot
from crashrate.variables import FloatArray

_GRID_SIZE = 56
FLATTER = 5  # points more in a plane: in space open symbols come out two to three times as large
_MAX_POINTS = 2000  # of corners, whose number grows with a power of the dimension


@dataclass(frozen=True)
class PointSet:
    """Points u (n, m) drawn alike, `notes` one text per point where there is more to say."""

    name: str
    u: FloatArray
    color: str
    symbol: str
    size: float
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class DominatingPoints:
    """Dominating points of the components on the inner and on the outer set."""

    inner: tuple[DominatingPoint, ...] = ()
    outer: tuple[DominatingPoint, ...] = ()


def point_sets(learned: Learned, dominating: DominatingPoints) -> tuple[PointSet, ...]:
    """Fronts, corners and dominating points; corners without a bound at the edge of the view."""
    s = learned.monotone
    corners = np.where(np.isfinite(s.corners), s.corners, learned.lower)
    sets = (
        PointSet("minimal crash", s.minimal_crashes, CRASH, "diamond", 4),
        PointSet("maximal safe point", s.maximal_safe, SAFE, "square", 3.5),
        _thinned(PointSet("corner of the outer set", corners, MUTED, "square-open", 2.5)),
        _dominating_set(learned, "dominating point, inner set", "diamond-open", dominating.inner),
        _dominating_set(learned, "dominating point, outer set", "circle-open", dominating.outer),
    )
    return tuple(p for p in sets if len(p.u))


def _thinned(points: PointSet) -> PointSet:
    """At most so many points as a page can hold, and a name that says so."""
    n = len(points.u)
    if n <= _MAX_POINTS:
        return points
    kept = np.linspace(0, n - 1, _MAX_POINTS).astype(int)
    name = f"{points.name} ({_MAX_POINTS:,} of {n:,})"
    return replace(points, name=name, u=points.u[kept])


def _dominating_set(
    learned: Learned, name: str, symbol: str, points: tuple[DominatingPoint, ...]
) -> PointSet:
    x = np.reshape([p.x for p in points], (-1, len(learned.order.variables)))
    return PointSet(name, learned.order(x), ACCENT, symbol, 4, _notes(points))


def _run_sets(learned: Learned) -> tuple[PointSet, ...]:
    u, y = learned.u, learned.outcomes
    sets = (
        # in space "x" is drawn as a glyph (U+274C) that many fonts lack, "cross" as a plus sign
        PointSet("run: crash", u[y == 1], CRASH, "cross", 5),
        PointSet("run: safe", u[y == 0], SAFE, "circle", 3),
        PointSet("run: failed", u[np.isnan(y)], INK, "diamond-open", 3),
    )
    return tuple(p for p in sets if len(p.u))


def space_plot(learned: Learned, dominating: DominatingPoints) -> Plot:
    """Runs, fronts, corners, dominating points, and the two surfaces between which crashes begin.

    Parameters
    ----------
    learned : Learned
        With at least three risk coordinates.
    dominating : DominatingPoints
    """
    at = learned.axes_to_draw()
    sets = (*_run_sets(learned), *point_sets(learned, dominating))
    traces = [_trace(learned, p, at) for p in sets]
    plot = figure(
        [*_surfaces(learned, at), *traces],
        height=640,
        margin={"l": 0, "r": 0, "t": 10, "b": 0},
        scene=_scene(learned, at),
        legend={"orientation": "h", "x": 0, "y": 0, "yanchor": "top", "itemsizing": "constant"},
    )
    return Plot(plot, f"Three-dimensional plot of the learned set: {counts_text(learned)}.")


def plane_plot(learned: Learned, dominating: DominatingPoints) -> Plot:
    """The learned set in two risk coordinates, with its fronts, corners and dominating points."""
    marks = [_trace(learned, p, (0, 1)) for p in point_sets(learned, dominating)]
    return section_plot(
        learned,
        0,
        1,
        marks,
        height=560,
        showlegend=True,
        margin={"l": 64, "r": 18, "t": 60, "b": 48},
    )


def counts_text(learned: Learned) -> str:
    """How many points the learned set is made of, in words."""
    s = learned.monotone
    return (
        f"{len(s.minimal_crashes)} minimal crashes, {len(s.maximal_safe)} maximal safe points, "
        f"{len(s.corners)} corners of the outer set"
    )


def _notes(points: Sequence[DominatingPoint]) -> tuple[str, ...]:
    return tuple(
        f"component {p.component} (weight {p.weight:.2g}), {p.distance:.1f} σ from its mean"
        for p in points
    )


def _inside(learned: Learned, u: FloatArray, at: Sequence[int]) -> np.ndarray:
    columns = list(at)
    low, high = learned.lower[columns], learned.upper[columns]
    return np.asarray(((u[:, columns] >= low) & (u[:, columns] <= high)).all(axis=1))


def _trace(learned: Learned, points: PointSet, at: Sequence[int]) -> dict[str, Any]:
    shown = _inside(learned, points.u, at)
    letters = "xyz"[: len(at)]
    columns = learned.physical(points.u[shown])[:, list(at)].T
    where = "<br>".join(
        f"{learned.axes[k].name} = %{{{c}:.4g}}" for k, c in zip(at, letters, strict=True)
    )
    note = "<br>%{text}" if points.notes else ""
    flat = len(at) == 2
    marker = {"color": points.color, "symbol": points.symbol, "size": points.size + FLATTER * flat}
    return {
        "type": "scatter" if flat else "scatter3d",
        **dict(zip(letters, columns, strict=True)),
        "mode": "markers",
        "name": points.name,
        "text": [n for n, s in zip(points.notes, shown, strict=True) if s] if note else None,
        "marker": marker,
        "hovertemplate": f"{points.name}<br>{where}{note}<extra></extra>",
    }


def _scene(learned: Learned, at: Sequence[int]) -> dict[str, Any]:
    axes = {
        f"{letter}axis": {
            "title": {"text": plain_text(learned.axes[k].label)},
            "range": list(learned.limits(k)),
            "gridcolor": GRID,
            "backgroundcolor": "#ffffff",
            "showbackground": True,
            "zerolinecolor": GRID,
            "exponentformat": "power",
            "nticks": 6,
        }
        for letter, k in zip("xyz", at, strict=True)
    }
    # the safe side in front would hide the boundary: look from where danger is
    eye = [1.45 * learned.signs[k] for k in at]
    return {
        **axes,
        "aspectmode": "cube",
        "camera": {
            "eye": {"x": eye[0], "y": eye[1] * 0.75, "z": abs(eye[2]) * 0.6},
            "center": {"x": 0, "y": 0, "z": -0.12},
        },
    }


def _surfaces(learned: Learned, at: Sequence[int]) -> list[dict[str, Any]]:
    """Where danger is known to begin, and where safety is known to end, along the third axis."""
    i, j, k = at
    a = np.linspace(learned.lower[i], learned.upper[i], _GRID_SIZE)
    b = np.linspace(learned.lower[j], learned.upper[j], _GRID_SIZE)
    s = learned.monotone
    heights = (
        ("boundary of the inner set", CRASH, _inner_height(learned, s.minimal_crashes, at, a, b)),
        ("boundary of the outer set", SAFE, _outer_height(learned, s.maximal_safe, at, a, b)),
    )
    signs = learned.signs
    return [
        {
            "type": "surface",
            "x": signs[i] * a,
            "y": signs[j] * b,
            "z": signs[k] * height,
            "name": name,
            "showlegend": True,
            "showscale": False,
            "opacity": 0.28,
            "colorscale": [[0, color], [1, color]],
            "hoverinfo": "skip",
            "contours": {"x": {"highlight": False}, "y": {"highlight": False}},
            "lighting": {"ambient": 0.85, "diffuse": 0.4, "specular": 0.02},
        }
        for name, color, height in heights
        if np.isfinite(height).any()
    ]


def _inner_height(
    learned: Learned, crashes: FloatArray, at: Sequence[int], a: FloatArray, b: FloatArray
) -> FloatArray:
    """Least u_k implied to crash at (u_i, u_j), the rest at the reference; NaN outside the view."""
    i, j, k = at
    rest = [c for c in range(len(learned.axes)) if c not in at]
    crashes = crashes[(crashes[:, rest] <= learned.reference[rest]).all(axis=1)]
    reached = (crashes[:, i, None, None] <= a) & (crashes[:, j, None, None] <= b[:, None])
    height = np.where(reached, crashes[:, k, None, None], np.inf).min(axis=0, initial=np.inf)
    height = np.maximum(height, learned.lower[k])
    return np.where(height <= learned.upper[k], height, np.nan)


def _outer_height(
    learned: Learned, safe: FloatArray, at: Sequence[int], a: FloatArray, b: FloatArray
) -> FloatArray:
    """Largest u_k implied to be safe at (u_i, u_j); NaN outside the view."""
    i, j, k = at
    rest = [c for c in range(len(learned.axes)) if c not in at]
    safe = safe[(safe[:, rest] >= learned.reference[rest]).all(axis=1)]
    reached = (safe[:, i, None, None] >= a) & (safe[:, j, None, None] >= b[:, None])
    height = np.where(reached, safe[:, k, None, None], -np.inf).max(axis=0, initial=-np.inf)
    height = np.minimum(height, learned.upper[k])
    return np.where(height >= learned.lower[k], height, np.nan)
