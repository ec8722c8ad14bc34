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


@pytest.fixture
def selection():
    return {
        "n_components": [1, 2, 3, 4, 5, 6],
        "bic": [90_000.0, 500.0, 100.0, 12.0, 15.0, 40.0],
        "bic_restarts": [[90_000.0, 90_000.0], [500.0, 501.0], [100.0, 130.0], [12.0, 20.0],
                         [15.0, 80_000.0], [40.0, None]],
        "held_out": [[-3.0, -4.0], [-2.3, -3.2], [-2.01, -2.91], [-2.0, -2.9], [-2.001, -2.902],
                     [-2.004, None]],
        "admissible": [4, 5],
        "left_out": [7],
    }  # fmt: skip


def test_bars_show_what_the_criterion_and_held_out_events_owe_to_the_start(selection):
    bic, held_out = (plot.figure for plot in bic_panel({"selection": selection}, 4).plots)
    assert list(bic.data[0].error_y.array) == [0, 1, 30, 8, 79_985, 0]
    assert list(bic.data[0].error_y.arrayminus) == [0] * 6  # the point is the best start
    line, highest = held_out.data
    assert line.y[3] == highest.y[0] == pytest.approx(0)
    assert line.y[4] == pytest.approx(-1.5)
    assert line.error_y.array[2] == pytest.approx(line.error_y.arrayminus[2])
    assert line.error_y.array[2] > 0
    assert highest.x[0] == 4


def test_far_points_and_bars_squash_no_plot_and_the_caption_says_so(selection):
    panel = bic_panel({"selection": selection}, 4)
    bic, held_out = (plot.figure.layout.yaxis.range for plot in panel.plots)
    assert 0 < 12 - bic[0] < 50
    assert 100 < bic[1] < 500
    assert held_out[1] > 0
    assert -100 < held_out[0] < -10
    assert "An axis is cut" in panel.caption
    near = {"n_components": [1, 2, 3], "bic": [10.0, -5.0, -3.0]}
    assert "An axis is cut" not in bic_panel({"selection": near}, 2).caption


def test_the_caption_names_the_numbers_that_are_admissible(selection):
    caption = bic_panel({"selection": selection}, 4).caption
    assert "not identified: differences of BIC between K = 4, 5 are below its spread" in caption
    assert "highest at K = 4" in caption
    assert "K = 7 was tried, but every start failed" in caption
    alone = bic_panel({"selection": selection | {"admissible": [4], "left_out": []}}, 4).caption
    assert "BIC tells K = 4 from the others" in alone
    assert "failed" not in alone


def test_scores_that_are_all_missing_are_not_drawn(selection):
    empty = selection | {"held_out": [[None]] * 6}
    assert len(bic_panel({"selection": empty}, 4).plots) == 1


def test_without_a_selection_bic_says_so():
    panel = bic_panel({}, 9)
    assert panel.plots == ()
    assert "given, not chosen" in panel.caption


def test_a_single_number_of_components_is_no_comparison():
    panel = bic_panel({"selection": {"n_components": [9], "bic": [-730907.4]}}, 9)
    assert panel.plots == ()
    assert "Only K = 9 was tried" in panel.caption
    assert "-730,907" in panel.caption
