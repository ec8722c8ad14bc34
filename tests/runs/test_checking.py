"""A run with its recordings: replayed once, remembered, and compared; the answer never lost."""

import json
from dataclasses import replace

import numpy as np
import pytest

from crashrate.errors import NumericalError, ScenarioError, SimulationError
from crashrate.estimation.alarms import Alarm
from crashrate.events import EventTable
from crashrate.recordings import check
from crashrate.runs import runner
from crashrate.runs.record import load_run
from crashrate.runs.scenario import Scenario
from crashrate.traffic.model import TrafficModel

N = 3000


@pytest.fixture
def rare():
    """Traffic in which the small vehicle crashes about once in 10,000 encounters."""
    return TrafficModel(
        [1.0], [[0.0, -1.6]], [np.diag([0.3, 0.3])], [0.0, -np.inf], [np.inf] * 2, ("a", "b")
    )


@pytest.fixture
def events(rare):
    return EventTable(("a", "b"), rare.sample(N, 5), "drawn", np.arange(N))


@pytest.fixture
def go(scenario, rare, events):
    def go(directory, **changes):
        settings = dict(seed=1, max_calls=200, events=events)
        return runner.run(scenario, rare, directory, **(settings | changes))

    return go


def recordings(directory):
    return json.loads((directory / "result.json").read_text())["recordings"]


def test_recordings_are_replayed_and_in_the_result(go, tmp_path, vehicle, events):
    said = []
    estimate = go(tmp_path / "run", say=said.append)
    found = recordings(tmp_path / "run")
    truth = int((events.values.sum(axis=1) > 1.0).sum())
    assert found["replay"]["n_crashes"] == truth
    assert found["replay"]["n_open"] == 0
    assert vehicle.n_runs == estimate.n_calls + found["replay"]["n_simulated"]
    assert found["sentences"][0].startswith(f"replay: the {N:,} events themselves give ")
    assert said[0] == f"replaying the recordings: 0 of {found['replay']['n_simulated']}"
    assert len(found["influence"]["events"]) == 10
    assert found["severity_ladder"] is None  # no variable closes in, and none is declared


def test_a_finished_run_is_checked_again_without_a_simulator_run(go, tmp_path, vehicle):
    go(tmp_path / "run")
    before, n = recordings(tmp_path / "run"), vehicle.n_runs
    go(tmp_path / "run")
    assert vehicle.n_runs == n
    assert recordings(tmp_path / "run") == before


def test_replay_is_no_part_of_the_campaign(go, tmp_path, scenario, rare):
    with_events = go(tmp_path / "with")
    alone = runner.run(scenario, rare, tmp_path / "alone", seed=1, max_calls=200)
    assert with_events.probability == alone.probability
    assert recordings(tmp_path / "alone") == {"unchecked": "no events were at hand"}
    assert len(load_run(tmp_path / "with").x) == alone.n_calls


def test_a_campaign_that_found_no_crash_says_why_nothing_was_replayed(go, tmp_path, monkeypatch):
    monkeypatch.setattr(Scenario, "simulator", lambda _: lambda x: np.zeros(len(x)))
    go(tmp_path / "run", max_calls=40)
    assert recordings(tmp_path / "run") == {
        "unchecked": "no crash was found, so nothing was learned that could settle the recorded "
        "events"
    }


@pytest.mark.parametrize(
    ("dropped", "raised"),
    [
        ({"not closing": 9000}, False),  # no encounters, and nothing is wrong with them
        ({"with a out of bounds": N // 10}, False),
        ({"with a out of bounds": N // 8, "not closing": 5}, True),
    ],
)
def test_many_rows_dropped_as_invalid_raise_an_alarm(scenario, rare, tmp_path, dropped, raised):
    origin = {"n": N, "dropped": dropped, "sha256": "", "source": "a.csv"}
    model = replace(rare, provenance={"events": origin})
    estimate = runner.run(scenario, model, tmp_path / "run", seed=1, max_calls=60)
    assert (Alarm.EVENTS_DROPPED in estimate.alarms) == raised
    result = json.loads((tmp_path / "run" / "result.json").read_text())
    assert any(a["name"] == "EVENTS_DROPPED" for a in result["alarms"]) == raised


def test_few_replays_leave_events_in_doubt(go, tmp_path):
    go(tmp_path / "run", replay_calls=0)
    replay = recordings(tmp_path / "run")["replay"]
    assert replay["n_simulated"] == 0
    assert replay["interval"][1] > 3 / N or replay["n_open"] == 0


def test_failed_simulation_is_told_and_tried_again(go, tmp_path, vehicle, monkeypatch):
    real = type(vehicle).__call__
    counted = go(tmp_path / "probe").n_calls

    def failing(self, x):
        outcomes = np.asarray(real(self, x), float)
        return outcomes if self.n_runs <= counted else np.full(len(x), np.nan)

    vehicle.n_runs = 0
    with monkeypatch.context() as patch:
        patch.setattr(type(vehicle), "__call__", failing)
        go(tmp_path / "run")
    replay = recordings(tmp_path / "run")["replay"]
    assert replay["n_crashes"] == 0
    assert replay["n_open"] == replay["n_failed"] == replay["n_simulated"] > 0
    assert "failed" in replay["sentence"]
    go(tmp_path / "run")
    assert recordings(tmp_path / "run") == recordings(tmp_path / "probe")


def test_interrupted_replay_goes_on(go, tmp_path, vehicle):
    calls = go(tmp_path / "probe").n_calls
    batches = vehicle.n_batches
    n_replays = recordings(tmp_path / "probe")["replay"]["n_simulated"]
    vehicle.n_batches = vehicle.n_runs = 0
    vehicle.trouble[batches] = RuntimeError("no licence")  # the last batch: of the replay
    with pytest.raises(RuntimeError):
        go(tmp_path / "run")
    left = json.loads((tmp_path / "run" / "result.json").read_text())
    assert left["n_calls"] == calls
    assert "not replayed yet" in left["recordings"]["pending"]
    load_run(tmp_path / "run")
    vehicle.trouble.clear()
    go(tmp_path / "run")
    assert vehicle.n_runs == calls + n_replays
    assert recordings(tmp_path / "run") == recordings(tmp_path / "probe")


def test_a_part_that_fails_is_told_and_loses_nothing(go, tmp_path, monkeypatch):
    def fail(*_):
        raise NumericalError("the information is no matrix")

    monkeypatch.setattr(check, "influential", fail)
    with pytest.warns(UserWarning, match="influence: the information is no matrix"):
        go(tmp_path / "run")
    found = recordings(tmp_path / "run")
    assert found["influence"] is None
    assert found["failed"] == {"influence": "the information is no matrix"}
    assert found["replay"]["n_events"] == N


def test_a_simulator_that_raises_on_an_event_leaves_it_in_doubt(go, tmp_path, vehicle):
    go(tmp_path / "alone", events=None)
    batches = vehicle.n_batches
    go(tmp_path / "probe")
    vehicle.n_batches = 0
    vehicle.trouble[batches + 1] = SimulationError("licence lost")  # the first of the replay
    with pytest.warns(UserWarning, match="replaying the recordings stopped: licence lost"):
        estimate = go(tmp_path / "run")
    found = recordings(tmp_path / "run")
    assert found["replay"]["n_open"] > 0
    assert found["influence"] is not None
    vehicle.trouble.clear()
    assert go(tmp_path / "run").probability == estimate.probability
    assert recordings(tmp_path / "run") == recordings(tmp_path / "probe")


def test_what_was_found_stays_while_the_answer_does(go, scenario, rare, tmp_path):
    go(tmp_path / "run")
    before = json.loads((tmp_path / "run" / "result.json").read_text())
    runner.run(scenario, rare, tmp_path / "run", seed=1, max_calls=200)  # without the events
    assert json.loads((tmp_path / "run" / "result.json").read_text()) == before
    runner.run(scenario, rare, tmp_path / "run", seed=1, relative_half_width=0.005, max_calls=400)
    assert recordings(tmp_path / "run") == {"unchecked": "no events were at hand"}


def test_equal_events_share_a_simulator_run(go, tmp_path, vehicle, events):
    worst = np.argsort(events.values.sum(axis=1))[-40:]
    values = np.array(events.values)
    values[worst] = values[worst[-1]]  # forty times the most dangerous
    calls = go(tmp_path / "probe").n_calls
    vehicle.n_runs = 0
    go(tmp_path / "run", events=replace(events, values=values), replay_calls=15)
    replay = recordings(tmp_path / "run")["replay"]
    assert replay["n_simulated"] == vehicle.n_runs - calls <= 15
    assert replay["n_open"] == 0
    crashes = bool(values[worst[-1]].sum() > 1.0)
    assert replay["n_crashes"] == 40 * crashes


def with_severity(scenario, text):
    return Scenario.from_text(f"{scenario.text}\n[severity]\n{text}\n", scenario.name)


def test_declared_severity_makes_a_ladder(scenario, rare, events, tmp_path):
    worse = with_severity(scenario, 'a = "a * severity"\nlevels = [1, 2, 4]')
    runner.run(worse, rare, tmp_path / "run", seed=1, max_calls=200, events=events)
    steps = recordings(tmp_path / "run")["severity_ladder"]
    assert steps["levels"] == [1, 2, 4]
    truth = [int((events.values @ [k, 1] > 1.0).sum()) for k in (1, 2, 4)]
    assert steps["observed"] == pytest.approx(truth, rel=0.1, abs=2)
    assert steps["p_value"] > 0.01  # the events were drawn from this very model


def test_severity_that_breaks_an_event_is_refused_before_any_run(
    scenario, rare, events, tmp_path, vehicle
):
    broken = with_severity(scenario, 'a = "0.3 * a / (1.3 - severity)"')
    with pytest.raises(
        ScenarioError, match=r"\[severity\]: expected finite numbers, got inf for a"
    ):
        runner.run(broken, rare, tmp_path / "run", seed=1, events=events)
    assert vehicle.n_runs == 0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('c = "a"', "unknown variable 'c'"),
        ("levels = [1, 2]", "at least one variable"),
        ('a = "a * factor"', "factor"),
        ('a = "a * severity"\nlevels = 3', "a list of numbers"),
        ('a = "a * severity"\nlevels = [2, 1]', "grow from 1"),
    ],
)
def test_what_is_no_severity_is_refused_with_its_place(scenario, text, said):
    with pytest.raises(ScenarioError, match=said) as refused:
        with_severity(scenario, text)
    assert "[severity]" in str(refused.value)


def test_closing_variable_is_multiplied_by_default():
    from pathlib import Path

    examples = Path(__file__).parents[2] / "examples"
    for name, variable in (("cut_in", "closing_speed"), ("huang2017", "inv_ttc")):
        found = Scenario.from_file(examples / f"{name}.toml")
        assert list(found.severity.changed) == [variable]
        worse = found.severity(np.array([[20.0, 0.02, 3.0]]), 2.0)
        assert worse.tolist() == [[20.0, 0.02, 6.0]]


def test_severity_of_one_must_change_nothing(scenario, rare, events, tmp_path, vehicle):
    worse = with_severity(scenario, 'a = "a * severity + 1"')
    with pytest.raises(ScenarioError, match="expected an event as it was recorded at severity 1"):
        runner.run(worse, rare, tmp_path / "run", seed=1, events=events)
    assert vehicle.n_runs == 0


@pytest.mark.parametrize("text", ['a = "a / severity"', 'b = "b - severity + 1"'])
def test_severity_that_makes_events_safer_is_refused(scenario, rare, events, tmp_path, text):
    with pytest.raises(ScenarioError, match="less dangerous in 'sum' than as it was recorded"):
        runner.run(with_severity(scenario, text), rare, tmp_path / "run", seed=1, events=events)


def test_severity_beyond_arithmetic_for_some_draws_is_no_crash(scenario, rare, events, tmp_path):
    odd = with_severity(scenario, 'b = "sqrt(b + 6) * severity - sqrt(b + 6) + b"')
    runner.run(odd, rare, tmp_path / "run", seed=1, max_calls=200, events=events)
    assert recordings(tmp_path / "run")["failed"] == {}
