"""What the report says of the recordings, from values as result.json holds them."""

import json

import pytest

from crashrate.recordings.check import Check
from crashrate.recordings.extremes import Extremes
from crashrate.recordings.influential import Influential, InfluentialEvent
from crashrate.recordings.ladder import Ladder
from crashrate.recordings.near_misses import Tail
from crashrate.recordings.replay import Replay
from crashrate.recordings.rivals import Rival
from crashrate.reports.figures.answers import answers_panel
from crashrate.reports.figures.tails import tail_panels
from crashrate.reports.html import render_report
from crashrate.reports.recordings import sheets

LEVELS = (1.0, 1.5, 2.0)
BARE = Ladder(LEVELS, (0, 6, 240), (0.4, 5.2, 250.0), (), (), 1.6, 0.94)
WITH_FITS = Ladder(LEVELS, (0, 6, 240), (0.4, 5.2, 250.0), (0.0, 2, 220), (0.7, 8, 260), 1.6, 0.94)
EVENT = InfluentialEvent(117, 0.2, 0.1, (6.7, 1.35, 0.09))
TAIL = Tail("TTC", "s", -1.0, (10, 100), (1.6, 2.7), (12.6, 140.0), (4.8, 81.4), (17.1, 120.5),
            (1.0, 1.6, 2.7), (0.9, 1.7, 2.6))  # fmt: skip


def found(ladder):
    return Check(
        Replay(157_757, 10, 1, 0, (136_426,)), ladder,
        Extremes(1e-6, (0.0, 9e-6), (0.0, 1e-5), -0.1, 250, 2.0),
        (TAIL,), Influential((EVENT,), 0.63, 0.26, 0),
        (Rival("independent marginals", 522_221.0, 2.5e-4, 1e-6, BARE, ((33.0, 777.0),)),), 11_703,
    )  # fmt: skip


@pytest.fixture
def make(build):
    def make(check):
        record = build()
        values = json.loads(json.dumps(check.to_dict()))
        return build(result=record.result | {"recordings": values})

    return make


@pytest.mark.parametrize("ladder", [BARE, WITH_FITS, None])
def test_the_page_shows_every_part(make, ladder):
    page = render_report(make(found(ladder)))
    assert "What the events say" in page
    for part in ("Near misses", "The events that decide", "Other ways to the same number"):
        assert part in page
    assert ("Severity ladder" in page) is (ladder is not None)
    assert ("Fits, 5 to 95 %" in page) is (ladder is WITH_FITS)
    assert "row 136426 crashes" in page
    assert "11,703 of the 157,757 events equal an earlier one" in page


def test_a_level_outside_its_range_is_marked(make):
    (near,) = [s for s in sheets(make(found(BARE))) if s.key == "near-misses"]
    assert [row[2] for row in near.rows] == ["12.6", "140 (outside)"]
    assert near.rows[0][0] == "TTC ≤ 1.6 s"
    assert near.headings[-1] == "Independent marginals"
    assert [row[-1] for row in near.rows] == ["33", "777"]


def test_without_recordings_the_page_says_so(build):
    page = render_report(build())
    assert "were not at hand" in page
    assert sheets(build()) == ()


def test_every_way_is_a_line_of_the_figure(estimate):
    panel = answers_panel(estimate(), found(BARE))
    names = panel.plots[0].figure.layout.yaxis.ticktext
    assert names[::-1] == (
        "this run", "replay of the events", "extreme-value theory", "independent marginals",
    )  # fmt: skip
    low, _ = panel.plots[0].figure.layout.xaxis.range
    assert all(10**low <= x * 1.0001 for t in panel.plots[0].figure.data for x in t.x)


def test_nothing_to_compare_with_is_said(estimate):
    assert answers_panel(estimate(), None).plots == ()


def test_tails_have_a_plot_for_each_quantity():
    ladder, tails = tail_panels(found(WITH_FITS))
    assert (ladder.key, tails.key) == ("ladder", "tails")
    assert len(tails.plots) == 1
    band = [t for t in ladder.plots[0].figure.data if t.name == "further fits"]
    assert min(band[0].y) > 0  # a logarithmic axis
    assert tail_panels(None) == ()
