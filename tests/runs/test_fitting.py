import hashlib
from dataclasses import replace

import numpy as np
import pytest

from crashrate.errors import EventsError, InvalidInputError, NumericalError
from crashrate.events import EventTable
from crashrate.runs import demo, fitting
from crashrate.runs.scenario import Scenario
from crashrate.traffic import ensemble
from crashrate.traffic.model import TrafficModel


@pytest.fixture
def events(traffic) -> EventTable:
    values = traffic.sample(3000, 0)
    return EventTable(("a", "b"), values, "drawn", np.arange(3000), {"not closing": 7})


@pytest.mark.parametrize(
    ("text", "expected"), [("9", (9,)), ("1:3", (1, 2, 3)), ("auto", tuple(range(1, 16)))]
)
def test_components_are_a_number_a_range_or_auto(text, expected):
    assert fitting.parse_components(text) == expected


@pytest.mark.parametrize("text", ["", "0", "3:1", "1:", ":3", "nine", "1.5", "1:2:3", "-1"])
def test_other_components_are_refused(text):
    with pytest.raises(InvalidInputError, match="expected a number such as 9"):
        fitting.parse_components(text)


def test_fewer_than_ten_events_a_component_are_refused(events):
    fitting.require_enough(events, (1, 300), "e.csv")
    words = r"e.csv: expected at least 10 events for each of 301 .* got 3000 .*\(up to 300,"
    with pytest.raises(InvalidInputError, match=words):
        fitting.require_enough(events, (1, 301), "e.csv")


def test_too_few_events_for_any_component_ask_for_more():
    few = EventTable(("a",), np.arange(9.0)[:, None], "drawn", np.arange(9))
    with pytest.raises(InvalidInputError, match=r"got 9 events; give more events\.$"):
        fitting.require_enough(few, (1,))


def test_a_constant_variable_is_refused_by_name(events):
    values = np.array(events.values)
    values[:, 0] = 20.0
    with pytest.raises(InvalidInputError, match=r"e\.csv: expected events that differ in 'a'"):
        fitting.require_enough(replace(events, values=values), (1,), "e.csv")


@pytest.mark.parametrize(("n", "warned"), [(189, True), (190, False)])
def test_few_events_per_parameter_are_told(n, warned):
    text = fitting.thin_data(n, 2, 3)  # 2 · (1 + 3 + 6) − 1 = 19 parameters
    assert bool(text) is warned
    assert not warned or "19 free parameters" in text


def test_model_remembers_where_it_comes_from(scenario, events):
    model = fitting.fit_traffic(scenario, events, (1, 2), seed=1)
    told = model.provenance["events"]
    assert {k: v for k, v in told.items() if k != "sample"} == {
        "source": "drawn",
        "n": 3000,
        "dropped": {"not closing": 7},
        "synthetic": False,
        "n_duplicates": 0,
        "sha256": hashlib.sha256(events.values.tobytes()).hexdigest(),
    }
    sample = np.array(told["sample"])
    assert sample.shape == (2000, 2)
    assert {tuple(row) for row in sample} <= {tuple(row) for row in events.values}
    assert model.provenance["selection"]["n_components"] == [1, 2]
    assert len(model.provenance["selection"]["bic"]) == 2
    assert model.names == ("a", "b")
    assert tuple(model.lower) == scenario.lower


def test_equal_seeds_fit_equal_bits_and_survive_the_file(scenario, events, tmp_path):
    model = fitting.fit_traffic(scenario, events, (2,), seed=5, synthetic=True)
    model.to_json(tmp_path / "traffic.json")
    assert TrafficModel.from_json(tmp_path / "traffic.json").to_json() == model.to_json()
    assert fitting.fit_traffic(scenario, events, (2,), seed=5, synthetic=True) == model
    assert model.provenance["events"]["synthetic"] is True


def test_further_fits_that_fail_are_left_out_unless_all_do(scenario, events, monkeypatch):
    real, n_sound = ensemble._fit, 1

    def fit(task, rows, parameters):
        if task.bootstrap is not None and not task.bootstrap % 2 < n_sound:
            raise NumericalError("collapsed")
        return real(task, rows, parameters)

    monkeypatch.setattr(ensemble, "_fit", fit)
    n_odd = sum(task.bootstrap % 2 for task in ensemble.member_tasks(6, (1,), 0))
    with pytest.warns(UserWarning, match=f"{n_odd} of 6 further fits failed"):
        model = fitting.fit_traffic(scenario, events, (1,), n_members=6)
    assert len(model.members) == 1 + 6 - n_odd
    n_sound = 0
    with pytest.raises(NumericalError, match="every further fit failed"):
        fitting.fit_traffic(scenario, events, (1,), n_members=2)


def test_events_are_read_as_the_scenario_says(tmp_path):
    text = """
    [variables.inv_range]
    lower = 0.01
    [variables.inv_ttc]
    [simulator]
    kind = "python"
    function = "a:b"
    [events.columns]
    inv_range = "1 / range"
    inv_ttc = "-range_rate / range"
    """
    scenario = Scenario.from_text(text)
    (tmp_path / "e.csv").write_text("range,range_rate\n10,-5\n20,1\n50,-1\n500,-1\n")
    with pytest.raises(EventsError, match="row 4"):
        fitting.read_scenario_events(scenario, tmp_path / "e.csv")
    events = fitting.read_scenario_events(scenario, tmp_path / "e.csv", drop_invalid=True)
    np.testing.assert_allclose(events.values, [[0.1, 0.5], [0.02, 0.02]])
    assert sum(events.dropped.values()) == 2


def test_demo_ships_the_published_scenario():
    from pathlib import Path

    shipped = demo.demo_scenario().to_text()
    example = Path(__file__).resolve().parents[2] / "examples" / "huang2017.toml"
    assert shipped == example.read_text()


def test_demo_events_are_as_many_as_the_study_had_and_say_they_are_synthetic():
    events = demo.demo_events(seed=2)
    assert len(events) == 157_757
    assert "synthetic" in events.source
    assert (events.values >= demo.demo_scenario().lower).all()
    assert not np.array_equal(events.values, demo.demo_events(seed=3).values)
