"""The tails of events and traffic model: the severity ladder, and quantiles of each quantity."""

from typing import Any

from crashrate.recordings.check import Check
from crashrate.recordings.ladder import Ladder
from crashrate.recordings.near_misses import Tail
from crashrate.reports.figures.style import CRASH, INK, MODEL, MUTED, axis, figure, log_axis, padded
from crashrate.reports.panel import Panel, Plot


def tail_panels(check: Check | None) -> tuple[Panel, ...]:
    """The ladder and the quantiles; none without recordings."""
    if check is None:
        return ()
    quantiles = tuple(_quantile_plot(tail) for tail in check.tails)
    panels = [] if check.ladder is None else [_ladder_panel(check.ladder)]
    if quantiles:
        panels.append(Panel("tails", "Tails of events and model", _QUANTILES, quantiles))
    return tuple(panels)


_QUANTILES = (
    "The most dangerous recorded values of each quantity against the traffic model's at the same "
    "share of encounters, the most dangerous at the end of the line. On the line both have the "
    "same tail; the last few points scatter in any case."
)


def _ladder_panel(ladder: Ladder) -> Panel:
    caption = (
        "Events that would crash if they were made worse by a factor (points, with the 95 % "
        "interval of a Poisson count; a level at which none crashes has no point), and what the "
        "traffic model expects (line"
        + (", 5 to 95 % of its further fits as a band)." if ladder.low else ").")
    )
    described = ", ".join(
        f"{o} against {e:.3g} at × {x:g}"
        for x, o, e in zip(ladder.levels, ladder.observed, ladder.expected, strict=True)
    )
    return Panel(
        "ladder", "Severity ladder", caption, (Plot(_ladder_figure(ladder), f"{described}."),)
    )


def _ladder_figure(ladder: Ladder) -> Any:
    seen = [(x, o) for x, o in zip(ladder.levels, ladder.observed, strict=True) if o]
    least = min([0.5, *(e for e in (*ladder.expected, *ladder.low) if e > 0)])
    most = max([1, *ladder.observed, *ladder.expected, *ladder.high])
    traces = [*_band(ladder, least), _expected(ladder), _observed(seen)]
    return figure(
        traces,
        height=340,
        xaxis=axis("severity factor", tickmode="array", tickvals=list(ladder.levels)),
        yaxis=log_axis("events that crash", max(least / 2, 1e-3), 2 * most),
    )


def _expected(ladder: Ladder) -> dict[str, Any]:
    return {
        "type": "scatter",
        "x": list(ladder.levels),
        "y": list(ladder.expected),
        "mode": "lines",
        "line": {"color": MODEL, "width": 2},
        "name": "expected by the traffic model",
        "hovertemplate": "× %{x}: %{y:.3g} expected<extra></extra>",
    }


def _band(ladder: Ladder, least: float) -> list[dict[str, Any]]:
    if not ladder.low:
        return []
    hidden = {"type": "scatter", "x": list(ladder.levels), "mode": "lines", "line": {"width": 0}}
    hidden |= {"hoverinfo": "skip"}
    low = [max(v, least) for v in ladder.low]
    return [
        hidden | {"y": list(ladder.high), "showlegend": False},
        hidden
        | {
            "y": low,
            "fill": "tonexty",
            "fillcolor": "rgba(0,158,115,0.18)",
            "name": "further fits",
        },
    ]


def _observed(seen: list[tuple[float, int]]) -> dict[str, Any]:
    from scipy.special import gammaincinv

    up = [float(gammaincinv(o + 1, 0.975)) - o for _, o in seen]
    down = [o - float(gammaincinv(o, 0.025)) for _, o in seen]
    return {
        "type": "scatter",
        "x": [x for x, _ in seen],
        "y": [o for _, o in seen],
        "error_y": {"type": "data", "array": up, "arrayminus": down, "color": CRASH, "width": 4},
        "mode": "markers",
        "marker": {"color": CRASH, "size": 9},
        "name": "events",
        "hovertemplate": "× %{x}: %{y} events<extra></extra>",
    }


def _quantile_plot(tail: Tail) -> Plot:
    values = [*tail.observed_quantiles, *tail.model_quantiles]
    low, high = padded(min(values), max(values))
    ends = [low, high] if tail.sign > 0 else [high, low]  # danger grows to the upper right
    line = {
        "type": "scatter",
        "x": [low, high],
        "y": [low, high],
        "mode": "lines",
        "line": {"color": MUTED, "width": 1, "dash": "dot"},
        "hoverinfo": "skip",
    }
    points = {
        "type": "scatter",
        "x": list(tail.model_quantiles),
        "y": list(tail.observed_quantiles),
        "mode": "markers",
        "marker": {"color": INK, "size": 5},
        "hovertemplate": "model %{x:.4g}<br>events %{y:.4g}<extra></extra>",
    }
    label = f"{tail.name} [{tail.unit}]" if tail.unit else tail.name
    return Plot(
        figure(
            [line, points],
            height=300,
            showlegend=False,
            xaxis=axis(f"{label}, model", range=ends, nticks=5),
            yaxis=axis("events", range=ends, nticks=5),
        ),
        f"Quantiles of {tail.name} in the events over those of the traffic model.",
    )
