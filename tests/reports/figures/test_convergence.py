import math

import numpy as np
import pytest

from crashrate.estimation.estimate import HistoryPoint
from crashrate.reports.figures.convergence import estimate_panel, half_width_panel


def traces(panel):
    return {t.name: t for t in panel.plots[0].figure.data if t.name}


def test_the_line_is_the_history_from_the_first_estimate(estimate):
    e = estimate()
    line = traces(estimate_panel(e))["estimate"]
    kept = [p for p in e.history if p.probability > 0]
    assert list(line.x) == [p.n_calls for p in kept]
    assert list(line.y) == [p.probability for p in kept]
    assert "The first estimate came after 60 runs" in estimate_panel(e).caption


def test_an_interval_that_reaches_zero_is_drawn_and_said(estimate):
    history = (HistoryPoint(10, 2e-6, -1e-6, 5e-6, "x"), HistoryPoint(20, 2e-6, 1e-7, 4e-6, "x"))
    panel = estimate_panel(estimate(history=history))
    band = traces(panel)["95 % interval"]
    assert all(y > 0 for y in band.y)
    assert panel.plots[0].figure.layout.yaxis.type == "log"
    assert "reaches 0" in panel.caption


def test_a_narrow_range_has_a_linear_axis_from_zero(estimate):
    history = tuple(HistoryPoint(n, 2e-6, 1.8e-6, 2.2e-6, "x") for n in (10, 20))
    axis = estimate_panel(estimate(history=history)).plots[0].figure.layout.yaxis
    assert axis.type is None
    assert axis.range[0] == 0


def test_half_width_against_target_and_crude_monte_carlo(estimate):
    e = estimate()
    found = traces(half_width_panel(e, 0.1))
    run, crude, target = found["this run"], found["crude Monte Carlo"], found["target ± 10\u00a0%"]
    assert set(target.y) == {0.1}
    last = [p for p in e.history if p.probability > 0][-1]
    assert run.y[-1] == pytest.approx((last.upper - last.lower) / 2 / last.probability)
    # z √((1 - p) / (p n)), at both ends
    p = e.probability
    for n, relative in zip(crude.x, crude.y, strict=True):
        assert relative == pytest.approx(1.959964 * math.sqrt((1 - p) / (p * n)), rel=1e-6)
    assert crude.x[-1] == pytest.approx(e.crude_monte_carlo_calls)
    assert crude.y[-1] == pytest.approx(e.relative_half_width)


def test_axes_are_logarithmic_and_hold_all_points(estimate):
    layout = half_width_panel(estimate(), 0.1).plots[0].figure.layout
    for axis in (layout.xaxis, layout.yaxis):
        assert axis.type == "log"
        assert len(axis.tickvals) == len(axis.ticktext) >= 2
        low, high = 10 ** np.array(axis.range)
        assert all(low <= v <= high for v in axis.tickvals)


@pytest.mark.parametrize(
    "changes",
    [
        {"history": ()},
        {"probability": math.nan, "interval": (0.0, 1.0), "history": ()},
        {"history": (HistoryPoint(10, math.nan, 0.0, 1.0, "explore"),)},
        {"probability": 0.0, "interval": (0.0, 0.0)},
    ],
)
def test_without_an_estimate_it_says_so(estimate, changes):
    e = estimate(**changes)
    panels = [half_width_panel(e, 0.1)]
    if not any(p.probability > 0 for p in e.history):
        panels.append(estimate_panel(e))
    for panel in panels:
        assert panel.plots == ()
        assert "yet" in panel.caption


def test_an_interval_of_no_width_draws_no_comparison(estimate):
    history = (HistoryPoint(10, 2e-6, 1e-6, 3e-6, "x"), HistoryPoint(20, 2e-6, 2e-6, 2e-6, "x"))
    panel = half_width_panel(estimate(interval=(2e-6, 2e-6), history=history), 0.1)
    assert panel.plots == ()


def test_a_run_no_better_than_crude_monte_carlo_fits_in_the_figure(estimate):
    e = estimate(probability=0.3, interval=(0.1, 0.5), n_calls=200)
    x_axis = half_width_panel(e, 0.1).plots[0].figure.layout.xaxis
    assert 10 ** x_axis.range[1] > 200 > e.crude_monte_carlo_calls


@pytest.mark.parametrize("p", [1.0, 1 - 1e-9])
def test_an_estimate_of_one_has_no_comparison(estimate, p):
    history = (HistoryPoint(20, p, 0.9, 1.0, "x"),)
    e = estimate(probability=p, interval=(0.9, 1.0), history=history)
    panel = half_width_panel(e, 0.1)
    assert panel.plots == ()
    assert "No comparison" in panel.caption
    assert estimate_panel(e).plots


def test_no_acceleration_is_none_to_speak_of(estimate):
    e = estimate(
        probability=0.5, interval=(0.4, 0.6), history=(HistoryPoint(200, 0.5, 0.4, 0.6, "x"),)
    )
    assert e.acceleration < 1
    assert "acceleration" not in half_width_panel(e, 0.1).caption
    assert "acceleration" in half_width_panel(estimate(), 0.1).caption
