"""Every way to the number on one axis: the run, the fits, the replay, extremes, other laws."""

from dataclasses import dataclass
from typing import Any

from crashrate.estimation.estimate import Estimate
from crashrate.recordings.check import Check
from crashrate.reports.figures.style import ACCENT, CRASH, INK, MODEL, SAFE, axis, figure, log_axis
from crashrate.reports.numbers import is_number, power_of_ten
from crashrate.reports.panel import Panel, Plot

_TITLE = "How far the events determine the number"
_MOST_DECADES = 1e-4  # the axis ends so far below the estimate


@dataclass(frozen=True)
class _Answer:
    """One line: a value with an interval, and single points."""

    name: str
    colour: str
    value: float
    low: float
    high: float
    points: tuple[float, ...] = ()


def answers_panel(estimate: Estimate, check: Check | None) -> Panel:
    """The probability by every way that the run knows."""
    answers = _answers(estimate, check)
    if len(answers) < 2:
        return Panel(
            "answers",
            _TITLE,
            "There is nothing to compare with: no further fits of the traffic model were told of, "
            "and its events were not at hand.",
        )
    caption = (
        "The interval of this run holds Monte Carlo error alone. The other lines say how much the "
        "number owes to the traffic model: the distance between them is doubt that no simulator "
        "run can remove. A line that reaches the left edge goes on to 0."
    )
    if estimate.traffic_range is not None:
        caption += " The small dots are single fits; one that the runs put at 0 or below has none."
    described = "; ".join(f"{a.name} {power_of_ten(a.value)}" for a in answers)
    return Panel("answers", _TITLE, caption, (Plot(_figure(answers), f"{described}."),))


def _answers(e: Estimate, c: Check | None) -> list[_Answer]:
    if not e.probability > 0:
        return []
    found = [_Answer("this run", INK, e.probability, *e.interval)]
    if e.traffic_range is not None and is_number(e.traffic_range.quantiles[1]):
        low, middle, high = e.traffic_range.quantiles
        points = tuple(p for p in e.traffic_range.probabilities if p > 0)
        found.append(_Answer("further fits, 5 to 95 %", SAFE, middle, low, high, points))
    if c is None:
        return found
    found.append(_Answer("replay of the events", CRASH, c.replay.probability, *c.replay.interval))
    if c.extremes is not None:
        x = c.extremes
        found.append(_Answer("extreme-value theory", ACCENT, x.probability, *x.interval))
    for r in c.rivals:
        width = 2 * r.standard_error
        sides = (r.probability - width, r.probability + width)
        found.append(_Answer(r.name, MODEL, r.probability, *sides))
    return found


def _figure(answers: list[_Answer]) -> Any:
    floor = _MOST_DECADES * answers[0].value
    values = [v for a in answers for v in (a.value, a.low, a.high, *a.points) if v > floor]
    low, high = max(min(values) / 2, floor), max(values) * 2
    traces = [t for k, a in enumerate(reversed(answers)) for t in _traces(a, k, low)]
    names = [a.name for a in reversed(answers)]
    return figure(
        traces,
        height=90 + 44 * len(answers),
        showlegend=False,
        xaxis=log_axis("crash probability", low, high),
        yaxis=axis("", tickmode="array", tickvals=list(range(len(names))), ticktext=names,
                   range=[-0.6, len(names) - 0.4], showgrid=False),
    )  # fmt: skip


def _traces(a: _Answer, k: int, low: float) -> list[dict[str, Any]]:
    line = {
        "type": "scatter",
        "x": [max(a.low, low), max(a.high, low)],
        "y": [k, k],
        "mode": "lines",
        "line": {"color": a.colour, "width": 3},
        "hoverinfo": "skip",
    }
    points = {
        "type": "scatter",
        "x": list(a.points),
        "y": [k - 0.22] * len(a.points),
        "mode": "markers",
        "marker": {"color": a.colour, "size": 5, "opacity": 0.5},
        "hovertemplate": "one fit: %{x:.2e}<extra></extra>",
    }
    value = {
        "type": "scatter",
        "x": [max(a.value, low)],
        "y": [k],
        "mode": "markers",
        "marker": {"color": a.colour, "size": 11},
        "hovertemplate": f"{a.name}: {a.value:.2e} [{a.low:.2e}, {a.high:.2e}]<extra></extra>",
    }
    return [line, *([points] if a.points else []), value]
