"""The data: every pair of variables and every variable alone, with the traffic model's draws."""

from collections.abc import Mapping
from itertools import combinations
from typing import Any

import numpy as np

from crashrate.reports.axes import Axis, variable_axes
from crashrate.reports.figures.style import INK, MODEL, axis, figure, padded
from crashrate.reports.panel import Panel, Plot
from crashrate.runs.record import RunRecord
from crashrate.variables import FloatArray

N_POINTS = 1500
_N_BINS = 40
_MAX_VARIABLES = 4
_DRAW_SEED = 0  # the page is a function of the run


def data_panel(record: RunRecord) -> Panel:
    """Pairs of variables and their histograms, of the events if the model keeps a sample."""
    draws = record.traffic.sample(N_POINTS, np.random.default_rng(_DRAW_SEED))
    events = _sample(record.traffic.provenance, len(record.traffic.names))
    axes = variable_axes(record.scenario)[:_MAX_VARIABLES]
    shown = draws if events is None else events
    name = _name(record, events)
    pairs = [
        _pair(shown, i, j, axes, name, known=events is not None)
        for i, j in combinations(range(len(axes)), 2)
    ]
    alone = [_histogram(events, draws, k, axes[k], name) for k in range(len(axes))]
    caption = _caption(record, events, shown)
    return Panel("data", "The encounters", caption, (*pairs, *alone))


def _sample(provenance: Mapping[str, Any], d: int) -> FloatArray | None:
    events = provenance.get("events") or {}
    sample = np.asarray(events.get("sample") or np.empty((0, d)), dtype=np.float64)
    return sample[:N_POINTS] if sample.ndim == 2 and sample.shape[1] == d and len(sample) else None


def _name(record: RunRecord, events: FloatArray | None) -> str:
    if events is None:
        return "drawn from the traffic model"
    return "synthetic events" if record.synthetic else "recorded events"


def _caption(record: RunRecord, events: FloatArray | None, shown: FloatArray) -> str:
    total = (record.traffic.provenance.get("events") or {}).get("n")
    if events is None:
        return (
            f"{len(shown):,} encounters drawn from the traffic model, which keeps no sample of the "
            "events it was fitted to."
        )
    of_all = f" of {total:,}" if total else ""
    return (
        f"{len(shown):,}{of_all} {_name(record, events)}, in pairs of variables; below, each "
        f"variable alone (bars) against {N_POINTS:,} draws from the traffic model (line)."
    )


def _window(values: FloatArray) -> list[float]:
    """All but the outermost thousandth: one stray value would squeeze the rest."""
    low, high = np.quantile(values, [0.001, 0.999])
    return list(padded(float(low), float(high)))


def _pair(x: FloatArray, i: int, j: int, axes: tuple[Axis, ...], name: str, *, known: bool) -> Plot:
    points = {
        "type": "scatter",
        "x": x[:, i],
        "y": x[:, j],
        "mode": "markers",
        "marker": {"size": 4, "color": INK if known else MODEL, "opacity": 0.35},
        "name": name,
        "hovertemplate": f"{axes[i].name} = %{{x:.4g}}<br>{axes[j].name} = %{{y:.4g}}"
        "<extra></extra>",
    }
    plot = figure(
        [points],
        height=300,
        showlegend=False,
        xaxis=axis(axes[i].label, range=_window(x[:, i]), nticks=5),
        yaxis=axis(axes[j].label, range=_window(x[:, j])),
    )
    return Plot(plot, f"Scatter of {axes[j].name} over {axes[i].name}, {name}.")


def _histogram(events: FloatArray | None, draws: FloatArray, k: int, on: Axis, name: str) -> Plot:
    seen = draws if events is None else np.vstack([events, draws])
    low, high = _window(seen[:, k])
    edges = np.linspace(max(low, seen[:, k].min()), min(high, seen[:, k].max()), _N_BINS + 1)
    traces = [] if events is None else [_bars(events[:, k], edges, name)]
    plot = figure(
        [*traces, _steps(draws[:, k], edges)],
        height=240,
        bargap=0,
        showlegend=False,
        xaxis=axis(on.label, range=[low, high], nticks=5),
        yaxis=axis("share of encounters", tickformat=".0%", rangemode="tozero", nticks=5),
    )
    return Plot(plot, f"Histogram of {on.name}.")


def _shares(values: FloatArray, edges: FloatArray) -> FloatArray:
    return np.asarray(np.histogram(values, edges)[0] / len(values))


def _bars(values: FloatArray, edges: FloatArray, name: str) -> dict[str, Any]:
    return {
        "type": "bar",
        "x": (edges[1:] + edges[:-1]) / 2,
        "y": _shares(values, edges),
        "width": np.diff(edges),
        "marker": {"color": "#b9c0c9", "line": {"width": 0}},
        "name": name,
        "hovertemplate": "%{x:.4g}: %{y:.1%}<extra></extra>",
    }


def _steps(values: FloatArray, edges: FloatArray) -> dict[str, Any]:
    shares = _shares(values, edges)
    return {
        "type": "scatter",
        "x": edges,
        "y": np.append(shares, shares[-1]),  # a step to the end of the last bin
        "mode": "lines",
        "line": {"color": MODEL, "width": 2, "shape": "hv"},
        "name": "drawn from the traffic model",
        "hoverinfo": "skip",
    }
