import dataclasses
import html
import math
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from crashrate.errors import StoreError
from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.reports.html import render_report, write_report

VOID = {"meta", "link", "br", "img", "hr", "input"}


class Page(HTMLParser):
    """Elements, visible text and resources of a page; refuses one that is not well-formed."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.open, self.elements, self.words, self.ids = [], [], [], []
        self.feed(text)
        self.close()
        assert not self.open, f"never closed: {self.open}"

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        self.ids += [value for name, value in attrs if name == "id"]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not {"script", "style"} & set(self.open):
            self.words.append(data)

    @property
    def text(self):
        return re.sub(r"\s+", " ", "".join(self.words))

    def find(self, tag):
        return [attrs for name, attrs in self.elements if name == tag]


def test_the_page_says_the_numbers_of_the_result(build):
    page = Page(render_report(build()))
    for said in (
        "P(crash) = 2.0 × 10⁻⁶ per encounter, 95 % Monte Carlo interval [1.8 × 10⁻⁶, 2.2 × 10⁻⁶]",
        "200 simulator runs; crude Monte Carlo would need 190 million",
        "1.2 × 10⁻⁶ ≤ p ≤ 8.1 × 10⁻⁶",
        "about one in 510,000",
        "131",
        "4.3 %",
        "1.87",
        "× 950,000",
        "the target was met",
        "sequential",
        "17",
        "crashrate 0.1.0, numpy 2.0",
        'closing_speed = "inv_ttc / inv_range"',
    ):
        assert said in page.text


def test_consequences_stand_near_the_answer(build, estimate, consequences):
    page = Page(render_report(build(estimate=estimate(consequences=consequences))))
    for said in (
        "ConsequenceExpected per encounter",
        "injury (aimed at)9.9 × 10⁻⁷",
        "(± 11 %)50 %60",
        "severenot determined",
    ):
        assert said in page.text
    assert "Expected per" not in Page(render_report(build())).text


def test_no_share_is_told_of_an_event_that_is_not_determined(build, estimate, consequences):
    e = estimate(consequences=consequences, interval=(0.0, 1e-3))
    assert "(± 11 %)–60" in Page(render_report(build(estimate=e))).text


def test_bounds_are_the_answer_where_they_were_asked_for(build, estimate):
    e = estimate(goal="bounds", probability=math.nan, interval=(0.0, 1.0), history=())
    page = Page(render_report(build(estimate=e)))
    assert "bounds if the risk order holds: 1.2 × 10⁻⁶ ≤ P(crash) ≤ 8.1 × 10⁻⁶" in page.text
    assert "upper over lower bound" in page.text
    assert "gave an estimate yet" not in page.text


def test_the_page_is_well_formed_and_accessible(build):
    page = Page(render_report(build()))
    assert len(page.ids) == len(set(page.ids))
    labels = {a["aria-labelledby"] for _, a in page.elements if "aria-labelledby" in a}
    assert labels <= set(page.ids)
    assert all(a.get("scope") in {"row", "col"} for a in page.find("th"))
    images = [a for _, a in page.elements if a.get("role") == "img"]
    assert len(images) >= 10
    assert all(a["aria-label"] for a in images)
    assert len(page.find("figcaption")) == len(page.find("figure")) == 5
    assert page.find("html") == [{"lang": "en"}]


def test_nothing_is_loaded_from_elsewhere(build):
    text = render_report(build())
    page = Page(text)
    sources = [a[k] for _, a in page.elements for k in ("src", "href", "action") if k in a]
    assert all(s.startswith("#") for s in sources)
    policy = next(a["content"] for a in page.find("meta") if "http-equiv" in a)
    assert "default-src 'none'" in policy
    assert "http" not in policy
    styles = re.findall(r"<style>(.*?)</style>", text, flags=re.DOTALL)
    assert not any("url(" in s or "@import" in s for s in styles)


def test_plotly_is_there_once_and_offers_no_upload(build):
    text = render_report(build())
    assert text.count("plotly.js v") == 1
    assert len(text) < 6e6
    n_plots = text.count("Plotly.newPlot(")
    assert n_plots >= 10
    assert len(re.findall(r'"showSendToCloud": ?false', text)) == n_plots


def test_no_alarm_is_said_and_alarms_are_shown_in_words(build, estimate):
    assert "No alarm" in Page(render_report(build())).text
    alarms = (Alarm.ORDER_CONTRADICTED, Alarm.TARGET_NOT_REACHED)
    page = Page(render_report(build(estimate=estimate(alarms=alarms))))
    assert "No alarm" not in page.text
    boxes = [a for a in page.find("div") if a.get("class") == "alarm"]
    assert len(boxes) == 2
    for alarm in alarms:
        assert page.text.count(alarm.value[1:]) == 2  # its box, and the list of all alarms
    assert page.text.count("raised") == 2


def test_a_model_that_nothing_was_compared_with_is_said_to_be_so(build):
    record = build()
    why = {"unchecked": "the method 'crude' learns no crash set"}
    told = dataclasses.replace(record, result=record.result | {"recordings": why})
    page = Page(render_report(told))
    assert "The traffic model is not checked against recordings: the method 'crude'" in page.text
    assert page.text.count("the method 'crude' learns no crash set") == 2  # and in its section


def test_an_aimed_consequence_heads_the_page(build, estimate, consequences):
    record = build(estimate=estimate(consequences=consequences))
    page = Page(render_report(record))
    heading = page.text.index("E(injury) =")
    assert heading < page.text.index("P(crash) =")
    assert "what was aimed at" in page.text


def test_a_dropped_order_draws_no_implied_sets(build, estimate):
    kept = Page(render_report(build())).text
    assert "inner set" in kept
    dropped = Page(render_report(build(estimate=estimate(alarms=(Alarm.ORDER_DROPPED,))))).text
    assert "The declared risk order was dropped, so that they imply nothing" in dropped
    assert "No risk order: the declared one was dropped" in dropped
    assert "shaded red" not in dropped.lower()


def test_an_interval_wider_than_its_estimate_is_shown_by_its_upper_end(build, estimate):
    wide = estimate(probability=2e-6, interval=(0.0, 3e-2))
    text = Page(render_report(build(estimate=wide))).text
    assert "≤ 0.03" in text
    assert "≤ 0.03" not in Page(render_report(build())).text


def test_synthetic_is_said_where_it_is_and_only_there(build):
    events = {"n": 1000, "sample": [[15.0, 0.03, 0.1]] * 20}
    real = Page(render_report(build(provenance={"events": events})))
    assert "synthetic" not in real.text.lower()
    assert "recorded events" in real.text
    drawn = Page(
        render_report(build(synthetic=True, provenance={"events": events | {"synthetic": True}}))
    )
    assert "Synthetic traffic." in drawn.text
    assert "fitted to 1,000 synthetic events" in drawn.text
    assert "recorded events" not in drawn.text


def test_hostile_names_and_texts_are_escaped(build):
    evil = "</script><script>alert(1)</script>"
    record = build(provenance={"events": {"n": 3}})
    variables = tuple(dataclasses.replace(v, unit=evil) for v in record.scenario.variables)
    scenario = dataclasses.replace(
        record.scenario, name=evil, variables=variables, text=f"# {evil}"
    )
    result = record.result | {"versions": {evil: evil}, "sentence": evil}
    text = render_report(dataclasses.replace(record, scenario=scenario, result=result))
    assert "<script>alert" not in text
    page = Page(text)
    assert page.text.count("alert(1)") > 5
    assert "&lt;script" in text or "\\u003cscript" in text


def test_no_crash_found(build, estimate):
    found = estimate(
        n_crashes=0,
        probability=math.nan,
        interval=(0.0, 0.015),
        standard_error=math.inf,
        bounds=(0.0, 0.01),
        log_efficiency=math.nan,
        alarms=(Alarm.NO_CRASH_FOUND,),
        stop_reason=StopReason.BUDGET_ENDED,
        history=(),
    )
    page = Page(render_report(build(estimate=found, danger=lambda x: -np.ones(len(x)))))
    assert "is not determined" in page.text
    assert "Probabilitynot determined" in page.text
    assert "No simulator run ended in a crash." in page.text
    assert "No batch of this run gave an estimate yet." in page.text
    assert not re.search(r"\b(nan|None|inf)\b", page.text)


@pytest.mark.parametrize(
    ("d", "risk"),
    [
        (1, {}),
        (1, {"x0": "decreasing"}),
        (2, {"x0": "increasing", "x1": "decreasing"}),
        (2, {}),
        (3, {"x0": "increasing"}),
        (5, {f"x{k}": "increasing" for k in range(5)}),
    ],
)
def test_any_number_of_variables_and_coordinates(build, problem, d, risk):
    record = build(problem(d, risk), danger=lambda x: x[:, 0] - 1.0, n=80)
    page = Page(render_report(record))
    assert "What the runs say" in page.text
    assert ("No risk order is declared" in page.text) == (not risk)
    assert ("Sections of the learned set" in page.text) == (len(risk) > 2)


def test_an_unfinished_run_without_any_outcome(build, estimate):
    empty = estimate(
        n_calls=0, n_crashes=0, probability=math.nan, history=(), stop_reason=StopReason.RUNNING
    )
    record = build(estimate=empty)
    record = dataclasses.replace(record, x=record.x[:0], outcomes=record.outcomes[:0])
    page = Page(render_report(record))
    assert "Not finished." in page.text
    assert "No simulator run yet." in page.text


def test_failed_runs_are_shown_as_such(build):
    record = build()
    outcomes = record.outcomes.copy()
    outcomes[::10] = np.nan
    text = render_report(dataclasses.replace(record, outcomes=outcomes))
    assert "run: failed" in text


def test_another_event_gets_its_words(build):
    words = '[outcome]\nevent = "collision"\nper = "merge"\n'
    base = build()
    page = Page(render_report(build(base.scenario.text + words)))
    assert "P(collision) = 2.0 × 10⁻⁶ per merge" in page.text
    assert "“crash” stands for the scenario's event: collision" in page.text


def test_the_report_is_a_function_of_the_run(build):
    assert render_report(build()) == render_report(build())


def test_writing(build, tmp_path):
    record = build()
    path = write_report(record, tmp_path / "report.html")
    assert path.read_text(encoding="utf-8") == render_report(record)
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    with pytest.raises(StoreError, match=r"no_such_folder.*expected a file to write to"):
        write_report(record, tmp_path / "no_such_folder" / "report.html")


def test_an_interval_of_no_width(build, estimate):
    exact = estimate(interval=(1.976e-6, 1.976e-6), stop_reason=StopReason.TARGET_MET, history=())
    page = Page(render_report(build(estimate=exact)))
    assert "the target was met" in page.text
    assert not re.search(r"\b(nan|None|inf|inf trillion)\b", page.text)


@pytest.mark.parametrize(
    "changes",
    [
        {"probability": 1.0, "interval": (0.98, 1.0)},
        {"probability": 0.5, "interval": (0.4, 0.6)},
        {"probability": 2e-6, "interval": (0.0, 6e-6)},
    ],
)
def test_no_silly_comparison_with_crude_monte_carlo(build, estimate, changes):
    page = html.unescape(render_report(build(estimate=estimate(**changes))))
    assert "in place of" not in page
    assert "× 0<" not in page
    assert ">none<" in page
    assert "in place of" in render_report(build())


def test_a_figure_without_data_is_a_sentence(build):
    page = render_report(build())
    assert '<p id="figure-bic"><strong>Number of mixture components.</strong>' in page
    assert '<figure id="figure-bic"' not in page
    numbers = [int(n) for n in re.findall(r"<strong>Figure (\d+)\.", page)]
    assert numbers == list(range(1, len(numbers) + 1))
    assert "surrogate" in page
