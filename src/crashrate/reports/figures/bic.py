"""How the number of mixture components was chosen: the Bayesian information criterion over K."""

from collections.abc import Mapping
from typing import Any

from crashrate.reports.figures.style import ACCENT, MUTED, axis, figure
from crashrate.reports.panel import Panel, Plot

_KEY = "bic"
_TITLE = "Number of mixture components"


def bic_panel(provenance: Mapping[str, Any], n_components: int) -> Panel:
    """BIC over the number of components, as stored with the traffic model when it was fitted.

    Parameters
    ----------
    provenance : mapping
        Of the traffic model; ``provenance["selection"]`` holds "n_components" and "bic".
    n_components : int
        Of the model in use.
    """
    selection = provenance.get("selection")
    if not selection or not selection.get("n_components"):
        return Panel(
            _KEY,
            _TITLE,
            f"The model has {n_components} components. Their number was given, not chosen from the "
            "data: this traffic model holds no comparison of the Bayesian information criterion.",
        )
    ks, values = list(selection["n_components"]), list(selection["bic"])
    if len(ks) == 1:
        return Panel(
            _KEY,
            _TITLE,
            f"Only K = {ks[0]} was tried, with a Bayesian information criterion of "
            f"{values[0]:,.0f}: the number of components was given, not chosen from the data.",
        )
    return Panel(_KEY, _TITLE, _caption(ks, values, n_components), (_plot(ks, values),))


def _caption(ks: list[int], values: list[float], n_components: int) -> str:
    best = ks[values.index(min(values))]
    return (
        f"Bayesian information criterion over the number of components K; lower is better. Lowest "
        f"of those compared: K = {best} (ringed). In use: K = {n_components}. A difference of a "
        "few units does not tell two models apart, and says little about the tail in which "
        "crashes lie."
    )


def _plot(ks: list[int], values: list[float]) -> Plot:
    best = values.index(min(values))
    curve = {
        "type": "scatter",
        "x": ks,
        "y": values,
        "mode": "lines+markers",
        "line": {"color": MUTED, "width": 1.5},
        "marker": {"color": MUTED, "size": 7},
        "name": "BIC",
        "hovertemplate": "K = %{x}<br>BIC = %{y:,.0f}<extra></extra>",
    }
    lowest = {
        "type": "scatter",
        "x": [ks[best]],
        "y": [values[best]],
        "mode": "markers",
        "marker": {"color": ACCENT, "size": 15, "symbol": "circle-open", "line": {"width": 3}},
        "name": f"lowest: K = {ks[best]}",
        "hoverinfo": "skip",
    }
    return Plot(
        figure(
            [curve, lowest],
            height=340,
            xaxis=axis("number of components K", dtick=1 if len(ks) <= 20 else None),
            yaxis=axis("BIC", tickformat=",.0f"),
        ),
        f"Line of the Bayesian information criterion for K from {min(ks)} to {max(ks)}; "
        f"lowest at K = {ks[best]}.",
    )
