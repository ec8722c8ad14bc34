"""The estimate and its interval over simulator runs, against the target and crude Monte Carlo."""

import math
from collections.abc import Sequence
from typing import Any

from crashrate.estimation.estimate import Estimate, HistoryPoint, in_words
from crashrate.reports.figures.style import (
    ACCENT,
    CRASH,
    INK,
    MUTED,
    SAFE,
    axis,
    figure,
    log_axis,
)
from crashrate.reports.numbers import percent, power_of_ten
from crashrate.reports.panel import Panel, Plot

_ROOM = 6.0  # right of crude Monte Carlo's end, for its label
_LOG_FROM = 5.0  # a logarithmic axis where the values span more than this factor


def estimate_panel(estimate: Estimate) -> Panel:
    """The estimate over runs with its interval as a band."""
    title = "The estimate over simulator runs"
    points = _estimates(estimate)
    if not points:
        return Panel("estimate", title, "No batch of this run gave an estimate yet.")
    plot = Plot(
        _estimate_figure(points, estimate.confidence),
        f"Estimate from {points[0].n_calls} to {points[-1].n_calls} simulator runs, ending at "
        f"{power_of_ten(estimate.probability)} within [{power_of_ten(estimate.interval[0])}, "
        f"{power_of_ten(estimate.interval[1])}].",
    )
    caption = (
        f"Estimate (line) and {100 * estimate.confidence:g} % interval (band) after each batch. "
        f"The first estimate came after {points[0].n_calls} runs; the runs before it explored. "
        "The interval is meant for the run on which the campaign stopped."
    )
    if any(p.lower <= 0 for p in points):
        caption += " Where an interval reaches 0, its band ends at the lower edge of the figure."
    return Panel("estimate", title, caption, (plot,))


def half_width_panel(estimate: Estimate, target: float | None) -> Panel:
    """Relative half-width of the interval over runs, the target, and crude Monte Carlo's."""
    title = "How tight the interval is, against crude Monte Carlo"
    points = [p for p in _estimates(estimate) if p.upper > p.lower]
    if not points or not 0 < estimate.relative_half_width < math.inf:
        return Panel(
            "half-width", title, "No interval of some width around an estimate above zero yet."
        )
    if math.isnan(estimate.crude_monte_carlo_calls):
        return Panel(
            "half-width",
            title,
            "No comparison: the interval is wider than the estimate to either side, or the "
            "estimate so close to 1 that crude Monte Carlo's formula asks for less than one run.",
        )
    plot = Plot(
        _half_width_figure(points, estimate, target),
        f"Relative half-width falls to {percent(estimate.relative_half_width)} at "
        f"{estimate.n_calls} runs; crude Monte Carlo needs about "
        f"{in_words(estimate.crude_monte_carlo_calls)} runs for the same.",
    )
    caption = (
        f"Half the {100 * estimate.confidence:g} % interval over the estimate, on logarithmic "
        "axes. Crude Monte Carlo draws encounters at random from the traffic model; its line is "
        "z √((1 − p) / (p n)) at this run's estimate p, for n runs."
    )
    if estimate.acceleration > 1:
        caption += (
            " The horizontal distance between the two lines is the acceleration: "
            f"{in_words(estimate.acceleration)} at the end."
        )
    return Panel("half-width", title, caption, (plot,))


def _estimates(estimate: Estimate) -> list[HistoryPoint]:
    return [p for p in estimate.history if p.probability > 0]


def _estimate_figure(points: Sequence[HistoryPoint], confidence: float) -> Any:
    low, high = _span(points)
    calls = [p.n_calls for p in points]
    log = high / low > _LOG_FROM
    title = "crash probability"
    y_axis = log_axis(title, low, high) if log else axis(title, range=[0, high])
    floor = low if log else -math.inf
    hidden = {"mode": "lines", "line": {"width": 0}, "hoverinfo": "skip"}
    upper = {"type": "scatter", "x": calls, "y": [p.upper for p in points], "showlegend": False}
    lower = {
        "type": "scatter",
        "x": calls,
        "y": [max(p.lower, floor) for p in points],
        "fill": "tonexty",
        "fillcolor": "rgba(0,114,178,0.18)",
        "name": f"{100 * confidence:g} % interval",
    }
    line = {
        "type": "scatter",
        "x": calls,
        "y": [p.probability for p in points],
        "mode": "lines+markers",
        "line": {"color": SAFE, "width": 2},
        "marker": {"size": 5},
        "name": "estimate",
        "customdata": [[p.lower, p.upper, p.phase] for p in points],
        "hovertemplate": "%{x} runs (%{customdata[2]})<br>%{y:.2e} "
        "[%{customdata[0]:.2e}, %{customdata[1]:.2e}]<extra></extra>",
    }
    x_axis = axis("simulator runs", range=[0, 1.03 * calls[-1]])
    return figure([upper | hidden, lower | hidden, line], xaxis=x_axis, yaxis=y_axis)


def _span(points: Sequence[HistoryPoint]) -> tuple[float, float]:
    """Range of the axis: all estimates, and the intervals up to a decade beyond them."""
    values = [p.probability for p in points]
    ends = [p.lower for p in points if p.lower > 0] + [p.upper for p in points if p.upper > 0]
    low = max(min([*values, *ends]), min(values) / 10)
    high = min(max([*values, *ends]), max(values) * 10)
    return 0.8 * low, 1.25 * high


def _half_width_figure(
    points: Sequence[HistoryPoint], estimate: Estimate, target: float | None
) -> Any:
    last = estimate.crude_monte_carlo_calls
    calls = [p.n_calls for p in points]
    relative = [(p.upper - p.lower) / 2 / p.probability for p in points]
    end = _ROOM * max(last, calls[-1])
    crude = [calls[0], last]
    unit = estimate.relative_half_width * math.sqrt(last)  # crude half-width falls as 1/√n
    crude_relative = [unit / math.sqrt(n) for n in crude]
    ends = [*relative, *crude_relative, target or relative[-1]]
    traces: list[dict[str, Any]] = [
        {
            "type": "scatter",
            "x": crude,
            "y": crude_relative,
            "mode": "lines",
            "line": {"color": CRASH, "width": 2, "dash": "dash"},
            "name": "crude Monte Carlo",
            "hoverinfo": "skip",
        },
        {
            "type": "scatter",
            "x": calls,
            "y": relative,
            "mode": "lines+markers",
            "line": {"color": SAFE, "width": 2},
            "marker": {"size": 5},
            "name": "this run",
            "hovertemplate": "%{x} runs<br>± %{y:.1%}<extra></extra>",
        },
    ]
    if target is not None:
        traces.append(_target_line(target, calls[0] / 2, end))
    return figure(
        traces,
        xaxis=log_axis("simulator runs", calls[0] / 2, end),
        yaxis=log_axis("relative half-width", min(ends) / 1.6, max(ends) * 1.6, as_percent=True),
        annotations=[
            _note(calls[-1], relative[-1], f"{calls[-1]:,} runs", 44),
            _note(last, crude_relative[-1], f"{in_words(last)} runs", 0),
        ],
    )


def _target_line(target: float, start: float, end: float) -> dict[str, Any]:
    return {
        "type": "scatter",
        "x": [start, end],
        "y": [target, target],
        "mode": "lines",
        "line": {"color": ACCENT, "width": 1.5, "dash": "dot"},
        "name": f"target ± {percent(target)}",
        "hoverinfo": "skip",
    }


def _note(calls: float, half_width: float, text: str, to_the_right: int) -> dict[str, Any]:
    return {
        "x": math.log10(calls),
        "y": math.log10(half_width),
        "text": text,
        "showarrow": True,
        "arrowcolor": MUTED,
        "arrowwidth": 1,
        "ax": to_the_right,
        "ay": -50,
        "font": {"color": INK},
    }
