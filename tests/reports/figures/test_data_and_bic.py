import numpy as np
import pytest

from crashrate.reports.figures.bic import bic_panel
from crashrate.reports.figures.data import N_POINTS, data_panel


def test_the_sample_of_events_is_drawn_in_pairs_and_alone(build):
    sample = np.random.default_rng(0).uniform([5, 0.02, 0.0], [35, 0.2, 0.5], (300, 3))
    panel = data_panel(build(provenance={"events": {"n": 5000, "sample": sample.tolist()}}))
    assert len(panel.plots) == 6
    scatter = panel.plots[0].figure
    np.testing.assert_allclose(np.column_stack([scatter.data[0].x, scatter.data[0].y]),
                               sample[:, :2])  # fmt: skip
    assert scatter.layout.xaxis.title.text == "v_lead [m/s]"
    assert scatter.layout.yaxis.title.text == "inv_range [1/m]"
    assert "300 of 5,000 recorded events" in panel.caption
    bars, steps = panel.plots[3].figure.data
    assert sum(bars.y) == pytest.approx(1, abs=0.01)
    assert len(steps.x) == len(bars.x) + 1


def test_without_a_sample_the_models_draws_are_drawn_and_called_so(build):
    panel = data_panel(build())
    assert len(panel.plots[0].figure.data[0].x) == N_POINTS
    assert panel.plots[0].figure.data[0].name == "drawn from the traffic model"
    assert "drawn from the traffic model" in panel.caption
    assert len(panel.plots[3].figure.data) == 1


def test_the_bic_curve_is_drawn_with_its_lowest_point():
    selection = {"n_components": [1, 2, 3], "bic": [10.0, -5.0, -3.0]}
    panel = bic_panel({"selection": selection}, 3)
    curve, lowest = panel.plots[0].figure.data
    assert list(curve.x) == [1, 2, 3]
    assert list(curve.y) == [10, -5, -3]
    assert (lowest.x[0], lowest.y[0]) == (2, -5)
    assert "K = 2 (ringed). In use: K = 3" in panel.caption


def test_without_a_selection_bic_says_so():
    panel = bic_panel({}, 9)
    assert panel.plots == ()
    assert "given, not chosen" in panel.caption


def test_a_single_number_of_components_is_no_comparison():
    panel = bic_panel({"selection": {"n_components": [9], "bic": [-730907.4]}}, 9)
    assert panel.plots == ()
    assert "Only K = 9 was tried" in panel.caption
    assert "-730,907" in panel.caption
