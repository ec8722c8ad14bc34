"""How the number of mixture components was chosen: BIC and held-out likelihood over K."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from crashrate.reports.figures.style import ACCENT, MUTED, axis, figure, padded
from crashrate.reports.panel import Panel, Plot
from crashrate.traffic.held_out import PER_EVENTS, held_out_gains, medians
from crashrate.variables import FloatArray

_KEY = "bic"
_TITLE = "Number of mixture components"
_FEW = 4  # ... or half, if that is more: the best K that set the axis; far ones would squash them
_HEADROOM = 2.0


@dataclass(frozen=True, slots=True)
class _Curve:
    """A quantity over K: its points, how low and high its starts go, and the best one."""

    name: str
    unit: str
    ks: Sequence[int]
    points: FloatArray
    low: FloatArray
    high: FloatArray
    best: int
    best_word: str


def bic_panel(provenance: Mapping[str, Any], n_components: int) -> Panel:
    """BIC and held-out likelihood over K, as stored with the traffic model when it was fitted.

    Parameters
    ----------
    provenance : mapping
        Of the traffic model; ``provenance["selection"]`` holds "n_components" and "bic", and may
        hold "bic_restarts", "held_out", "admissible" and "left_out".
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
    curves = [_bic_curve(selection), *_held_out_curves(selection)]
    plots = tuple(_plot(curve) for curve in curves)
    return Panel(_KEY, _TITLE, _caption(selection, curves, n_components), plots)


def _bic_curve(selection: Mapping[str, Any]) -> _Curve:
    """The best start's criterion; bars reach to the worst start's."""
    points = np.array(selection["bic"], dtype=np.float64)
    starts = np.array(selection.get("bic_restarts") or points[:, None], dtype=np.float64)
    best = int(points.argmin())
    high = np.nanmax(starts, axis=1)
    return _Curve("BIC", "BIC", selection["n_components"], points, points, high, best, "lowest")


def _held_out_curves(selection: Mapping[str, Any]) -> list[_Curve]:
    """The median split's gain, bars over all splits; nothing where the model holds none."""
    gains = held_out_gains(selection.get("held_out") or [[]])
    there = np.isfinite(gains)
    if not there.any():
        return []
    points = medians(gains)
    low = np.min(gains, axis=1, where=there, initial=np.inf)
    high = np.max(gains, axis=1, where=there, initial=-np.inf)
    name, unit = "held-out log likelihood", f"held out, per {PER_EVENTS} events"
    best = int(np.nanargmax(points))
    return [_Curve(name, unit, selection["n_components"], points, low, high, best, "highest")]


def _caption(selection: Mapping[str, Any], curves: Sequence[_Curve], n_components: int) -> str:
    bic, *held_out = curves
    left_out = selection.get("left_out") or ()
    sentences = (
        "Bayesian information criterion over the number of components K; lower is better.",
        f"Lowest of those compared: K = {bic.ks[bic.best]} (ringed). In use: K = {n_components}.",
        *["Points are the best of several starts, bars reach to the worst."] * _has_bars(bic),
        _identified(selection.get("admissible") or ()),
        *(f"K = {k} was tried, but every start failed." for k in left_out),
        *(_of_held_out(curve) for curve in held_out),
        *["An axis is cut to show the better K: far points and bars leave it."] * _any_cut(curves),
        "None of this says much about the tail in which crashes lie.",
    )
    return " ".join(sentences)


def _of_held_out(curve: _Curve) -> str:
    return (
        f"Held-out log likelihood per {PER_EVENTS} events, less the highest: of about a fifth of "
        "the events under a fit of the others; higher is better, and no price of a parameter is "
        "assumed. Points are medians over splits, bars their range; highest at "
        f"K = {curve.ks[curve.best]}."
    )


def _identified(admissible: Sequence[int]) -> str:
    if len(admissible) > 1:
        named = ", ".join(map(str, admissible))
        return (
            "The number of components is not identified: differences of BIC between K = "
            f"{named} are below its spread over starts, so each of them is admissible."
        )
    if admissible:
        return f"BIC tells K = {admissible[0]} from the others by more than its spread over starts."
    return "A difference of a few units does not tell two models apart."


def _view(curve: _Curve) -> tuple[float, float]:
    """The range of the axis: the better half of K and an ordinary bar, and as much again."""
    sign = 1.0 if curve.best_word == "lowest" else -1.0
    n_near = max(_FEW, len(curve.ks) // 2)
    there = np.flatnonzero(np.isfinite(curve.points))
    near = there[np.argsort(sign * curve.points[there])[:n_near]]
    bars = curve.high[near] - curve.low[near]
    reach = max(float(np.ptp(curve.points[near])), float(np.median(bars)))
    start, end = float(curve.low[near].min()), float(curve.high[near].max())
    if sign > 0:
        return padded(start, min(start + _HEADROOM * reach, float(curve.high.max())))
    return padded(max(end - _HEADROOM * reach, float(curve.low.min())), end)


def _any_cut(curves: Sequence[_Curve]) -> bool:
    views = [_view(curve) for curve in curves]
    return any(
        bool((curve.low < low).any() or (curve.high > high).any())
        for curve, (low, high) in zip(curves, views, strict=True)
    )


def _has_bars(curve: _Curve) -> bool:
    return bool((curve.high > curve.low).any())


def _plot(curve: _Curve) -> Plot:
    ks, k = curve.ks, curve.ks[curve.best]
    line = {
        "type": "scatter",
        "x": list(ks),
        "y": curve.points,
        "mode": "lines+markers",
        "line": {"color": MUTED, "width": 1.5},
        "marker": {"color": MUTED, "size": 7},
        "name": curve.name,
        "hovertemplate": "K = %{x}<br>%{y:,.2f}<extra></extra>",
    }
    if _has_bars(curve):
        line["error_y"] = {
            "type": "data",
            "symmetric": False,
            "array": curve.high - curve.points,
            "arrayminus": curve.points - curve.low,
            "color": MUTED,
            "thickness": 1.2,
        }
    ringed = {
        "type": "scatter",
        "x": [k],
        "y": [curve.points[curve.best]],
        "mode": "markers",
        "marker": {"color": ACCENT, "size": 15, "symbol": "circle-open", "line": {"width": 3}},
        "name": f"{curve.best_word}: K = {k}",
        "hoverinfo": "skip",
    }
    return Plot(
        figure(
            [line, ringed],
            height=340,
            xaxis=axis("number of components K", dtick=1 if len(ks) <= 8 else None),
            yaxis=axis(curve.unit, tickformat=",", range=_view(curve)),
        ),
        f"Line of {curve.name} for K from {min(ks)} to {max(ks)}; {curve.best_word} at K = {k}.",
    )
