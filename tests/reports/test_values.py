import json
import math

import pytest

from crashrate.errors import StoreError
from crashrate.estimation.alarms import Alarm
from crashrate.estimation.order_audit import OrderAudit
from crashrate.estimation.suspect import Suspect
from crashrate.reports.axes import units_of
from crashrate.reports.evidence import evidence
from crashrate.reports.likeliest import likeliest_crashes
from crashrate.reports.numbers import count, percent, plain, power_of_ten
from crashrate.reports.results import estimate_of
from crashrate.reports.units import derived_unit


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1.976e-6, "2.0 × 10⁻⁶"),
        (123456.0, "1.2 × 10⁵"),
        (0.05, "0.05"),
        (0, "0"),
        (None, "not available"),
        (math.nan, "not available"),
        (math.inf, "not available"),
    ],
)
def test_powers_of_ten(value, text):
    assert power_of_ten(value).replace("\u00a0", " ") == text


def test_percentages_and_counts():
    assert percent(0.0431).replace("\u00a0", " ") == "4.3 %"
    assert percent(98.0).replace("\u00a0", " ") == "9,800 %"
    assert percent(1e-6).replace("\u00a0", " ") == "0.0001 %"
    assert (percent(None), count(math.nan), plain(None)) == ("not available",) * 3
    assert count(157757) == "157,757"


def test_the_estimate_comes_back_from_json(estimate, consequences):
    e = estimate(alarms=(Alarm.NO_ORDER,))
    back = estimate_of(json.loads(json.dumps(e.to_dict())))
    assert back.to_dict() == e.to_dict()
    assert back.sentence() == e.sentence()
    led = estimate(consequences=consequences)
    assert estimate_of(json.loads(json.dumps(led.to_dict()))).consequences == consequences
    nothing = estimate(probability=math.nan, standard_error=math.inf, history=())
    assert math.isnan(estimate_of(nothing.to_dict()).probability)


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("1 / inv_range", "m"),
        ("inv_ttc / inv_range", "m/s"),
        ("inv_ttc * inv_ttc / inv_range", "m/s²"),
        ("v_lead ** 2 / 2", "m²/s²"),
        ("v_lead + inv_ttc / inv_range", "m/s"),
        ("v_lead / v_lead", ""),
        ("(v_lead ** 2) ** 0.5", "m/s"),
        ("-v_lead", "m/s"),
        ("v_lead + inv_ttc", ""),
        ("exp(v_lead)", ""),
        ("v_lead ** 0.5", ""),
        ("odd * v_lead", ""),
        ("unknown * v_lead", ""),
    ],
)
def test_units_of_derived_quantities(text, unit):
    units = {"v_lead": "m/s", "inv_range": "1/m", "inv_ttc": "s^-1", "odd": "fur-long?"}
    assert derived_unit(text, units) == unit


def test_units_of_a_scenario(build):
    assert units_of(build().scenario) == {
        "v_lead": "m/s",
        "inv_range": "1/m",
        "inv_ttc": "1/s",
        "range": "m",
        "closing_speed": "m/s",
    }


def test_the_likeliest_crashes(build):
    record = build()
    table = likeliest_crashes(record)
    assert [a.label for a in table.headings] == [
        "v_lead [m/s]", "inv_range [1/m]", "inv_ttc [1/s]", "range [m]", "closing_speed [m/s]",
    ]  # fmt: skip
    runs = [run - 1 for run, _, _ in table.rows]
    assert len(runs) == 10
    density = record.traffic.log_density(record.x)
    crashes = [i for i in range(len(density)) if record.outcomes[i] == 1]
    assert runs == sorted(crashes, key=lambda i: -density[i])[:10]
    v, k, t = record.x[runs[0]]
    assert [float(c) for c in table.rows[0][2]] == pytest.approx([v, k, t, 1 / k, t / k], rel=1e-4)
    # the CSV gives the situations back bit for bit
    lines = table.csv.splitlines()
    assert lines[0] == "v_lead,inv_range,inv_ttc"
    assert [[float(c) for c in line.split(",")] for line in lines[1:]] == record.x[runs].tolist()


def test_bounds_and_their_audit_come_back_and_are_evidence(build, estimate):
    audit = OrderAudit(20, 1, 0.25, 20, 0, 0.17, 3e-6, 0.95)
    e = estimate(
        goal="bounds", probability=math.nan, interval=(0.0, 1.0), history=(), order_audit=audit
    )
    back = estimate_of(json.loads(json.dumps(e.to_dict())))
    assert (back.goal, back.order_audit) == ("bounds", audit)
    facts = {f.name: f for f in evidence(build(estimate=e), e)}
    assert facts["Probability"].value == "not estimated: the runs went into its bounds"
    assert facts["95 % interval"].value == "none"
    assert facts["Audit of the order"].value == "1 of 40 contradict it"
    meaning = facts["Audit of the order"].meaning.replace("\u00a0", " ")
    assert "at least 9.0 × 10⁻⁷ whatever the order" in meaning


def test_a_suspect_direction_comes_back_and_is_evidence(build, estimate):
    found = Suspect("range", 187, 44, 0)
    e = estimate(order_suspect=found)
    back = estimate_of(json.loads(json.dumps(e.to_dict())))
    assert back.order_suspect == found
    facts = {f.name: f for f in evidence(build(estimate=e), e)}
    assert facts["Suspect direction"].value == "range"
    assert facts["Suspect direction"].meaning.startswith("Look at the direction of range first")
    assert "Suspect direction" not in {f.name for f in evidence(build(), estimate())}


def test_evidence_without_an_order_claims_no_bounds(build, estimate):
    e = estimate(bounds=(0.0, 1.0))
    facts = {f.name: f for f in evidence(build(estimate=e), e)}
    assert facts["Bounds"].value == "none"
    assert "Nothing is implied" in facts["Bounds"].meaning


def test_the_evidence_says_where_the_events_came_from(build, estimate):
    events = {"n": 1000, "source": "events.csv", "dropped": {"not closing": 12, "NaN": 0}}
    facts = {f.name: f for f in evidence(build(provenance={"events": events}), estimate())}
    assert facts["Traffic model"].value.endswith(
        "fitted to 1,000 recorded events (events.csv); left out: 12 (not closing)"
    )


def test_bounds_are_not_called_certain_where_the_order_is_contradicted(build, estimate):
    e = estimate(alarms=(Alarm.ORDER_CONTRADICTED,))
    for value, said in ((e, True), (estimate(), False)):
        facts = {f.name: f for f in evidence(build(estimate=value), value)}
        assert ("here some outcomes contradict it" in facts["Bounds"].meaning) == said


@pytest.mark.parametrize(
    "change",
    [{"alarms": [{"name": "FROM_THE_FUTURE"}]}, {"stop_reason": "tired"}, {"interval": 3}],
)
def test_a_result_of_another_version_is_refused(estimate, change):
    with pytest.raises(StoreError, match="expected what this version of crashrate writes"):
        estimate_of(estimate().to_dict() | change)
