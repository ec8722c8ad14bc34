import pytest

from crashrate.reports.figures.style import log_axis, log_ticks, plain_text, to_div


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (1e-7, 1e-6, [1e-7, 2e-7, 3e-7, 5e-7, 1e-6]),
        (1.8e-6, 2.2e-6, [2e-6]),
        (9, 2_000, [10, 20, 50, 100, 200, 500, 1000, 2000]),
        (1, 1e4, [1, 10, 100, 1e3, 1e4]),
        (1, 1e16, [1e0, 1e2, 1e4, 1e6, 1e8, 1e10, 1e12, 1e14, 1e16]),
    ],
)
def test_ticks(low, high, expected):
    assert log_ticks(low, high) == pytest.approx(expected)


def test_tick_texts_have_no_e_notation():
    texts = log_axis("p", 1e-6, 8e-6)["ticktext"]
    assert texts[0] == "10⁻⁶"
    assert "2×10⁻⁶" in texts
    assert log_axis("share", 0.05, 200, as_percent=True)["ticktext"] == [
        "10 %", "100 %", "1,000 %", "10,000 %",
    ]  # fmt: skip
    assert not any("e" in t for t in texts)


def test_labels_are_plain_text():
    assert plain_text("<b>a & b</b>") == "&lt;b&gt;a &amp; b&lt;/b&gt;"


def test_a_div_holds_no_plotly_and_its_own_key():
    import plotly.graph_objects as go

    text = to_div(go.Figure(), "plot-1")
    assert 'id="plot-1"' in text
    assert "cdn" not in text
    assert len(text) < 10_000
