"""One look for all figures: fonts, colours, axes, and how a figure becomes HTML."""

import html
import math
from collections.abc import Sequence
from typing import Any

import plotly.graph_objects as go
import plotly.io

from crashrate.reports.numbers import superscript

# Okabe & Ito (2008), "Color universal design": told apart by all kinds of colour vision.
CRASH = "#D55E00"
SAFE = "#0072B2"
MODEL = "#009E73"
ACCENT = "#7A3E9D"
INK = "#1f2328"
MUTED = "#6b7280"
GRID = "#e4e7eb"
CRASH_FILL = "#F6CDB3"
SAFE_FILL = "#C6DDED"
UNDECIDED_FILL = "#F4F4F2"

# widest axis in decades, and what its ticks begin with
_MANTISSAS = ((0.75, (1, 1.5, 2, 2.5, 3, 4, 5, 6, 8)), (1.2, (1, 2, 3, 5)), (2.5, (1, 2, 5)))

FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"
_CONFIG = {
    "responsive": True,
    "displaylogo": False,
    "modeBarButtonsToRemove": ["lasso2d", "select2d", "autoScale2d"],
    # plotly's own default offers to upload the figure: a report must not
    "showSendToCloud": False,
    "plotlyServerURL": "",
}


def figure(traces: Sequence[Any], *, height: int = 380, **layout: Any) -> go.Figure:
    """A figure in the report's style."""
    return go.Figure(
        data=list(traces),
        layout={
            # an empty template: plotly's own would repeat 7 kB in every figure
            "template": go.layout.Template(),
            "height": height,
            "margin": {"l": 64, "r": 18, "t": 18, "b": 48},
            "paper_bgcolor": "#ffffff",
            "plot_bgcolor": "#ffffff",
            "font": {"family": FONT, "size": 13, "color": INK},
            "legend": legend_below(),
            "hoverlabel": {"font": {"family": FONT}},
            **layout,
        },
    )


def legend_below() -> dict[str, Any]:
    """A horizontal legend above the plot, where it hides no point on a narrow screen."""
    return {"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom", "xanchor": "left"}


def axis(title: str, **options: Any) -> dict[str, Any]:
    """An axis with a light grid; `title` is plain text."""
    return {
        "title": {"text": plain_text(title), "standoff": 8},
        "showline": True,
        "linecolor": MUTED,
        "gridcolor": GRID,
        "zeroline": False,
        "ticks": "outside",
        "tickcolor": MUTED,
        "ticklen": 4,
        "automargin": True,
        "exponentformat": "power",
        "nticks": 7,
        **options,
    }


def log_axis(title: str, low: float, high: float, *, as_percent: bool = False) -> dict[str, Any]:
    """A logarithmic axis over [low, high] whose ticks are written out in full.

    Parameters
    ----------
    title : str
    low, high : float
        Positive.
    as_percent : bool
        Whether ticks read ``10 %`` for 0.1.
    """
    values = log_ticks(low, high)
    write = _percent_tick if as_percent else _tick
    return axis(
        title,
        type="log",
        range=[math.log10(low), math.log10(high)],
        tickmode="array",
        tickvals=values,
        ticktext=[write(v) for v in values],
    )


def log_ticks(low: float, high: float) -> list[float]:
    """Ticks inside [low, high]: several of every decade, or powers of ten where those are many."""
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    decades = math.log10(high / low)
    mantissas = next((m for limit, m in _MANTISSAS if decades <= limit), (1,))
    step = max(1, math.ceil(decades / 8))
    ticks = [float(f"{m}e{e}") for e in range(first, last + 1, step) for m in mantissas]
    return [t for t in ticks if low * (1 - 1e-9) <= t <= high * (1 + 1e-9)]


def _tick(value: float) -> str:
    if 0.01 <= value < 10_000:
        return f"{value:,g}"
    mantissa, exponent = f"{value:.1e}".replace(".0e", "e").split("e")
    power = f"10{superscript(int(exponent))}"
    return power if mantissa == "1" else f"{mantissa}×{power}"


def _percent_tick(value: float) -> str:
    percentage = float(f"{100 * value:.12g}")
    return f"{percentage:,g} %" if percentage < 100_000 else f"{_tick(percentage)} %"


def plain_text(text: str) -> str:
    """`text` made safe for plotly's labels, which read a few HTML tags."""
    return html.escape(text, quote=False)


def padded(low: float, high: float, share: float = 0.06) -> tuple[float, float]:
    """The range [low, high] with a margin."""
    margin = share * (high - low) or 0.5 * abs(high) or 1.0
    return low - margin, high + margin


def to_div(plot: go.Figure, key: str) -> str:
    """The HTML of a figure; the page holds plotly.js once, elsewhere.

    Parameters
    ----------
    plot : Figure
    key : str
        Identifier in the page.
    """
    # on a flat figure plotly's buttons would lie on the legend, and double click resets the view
    config = _CONFIG | {"displayModeBar": any(t.type.endswith("3d") for t in plot.data)}
    return str(
        plotly.io.to_html(plot, full_html=False, include_plotlyjs=False, div_id=key, config=config)
    )
