"""Consequences on disk: declared in the scenario, stored, resumed, part of what a run is."""

import json
from dataclasses import replace

import numpy as np
import pytest

from crashrate.errors import InvalidInputError, ScenarioError, SimulationError, StoreError
from crashrate.estimation import methods
from crashrate.estimation.alarms import StopReason
from crashrate.estimation.consequence import Consequence
from crashrate.estimation.strategy import Query, Snapshot
from crashrate.runs.record import load_run
from crashrate.runs.runner import run, status
from crashrate.runs.scenario import Scenario
from crashrate.runs.store import Batch, RunStore
from crashrate.runs.vehicle import simulator_of

DECLARED = '[outcome]\nevent = "near miss"\nconsequences = ["injury", "severe"]\n'


def adaptive(problem):
    """Crude Monte Carlo whose next draws depend on every outcome and consequence so far."""
    told, snapshot, k = np.empty((0, 1 + len(problem.consequences))), Snapshot(), 0
    while len(told) < problem.max_calls:
        rng = problem.rng(k + int(1000 * np.nansum(told)))
        x = problem.traffic.sample(problem.batch_size, rng)[: problem.max_calls - len(told)]
        told = np.concatenate([told, (yield Query(x, snapshot))])
        k += 1
        found = tuple(
            Consequence(
                name=name,
                mean=float(np.nanmean(z)),
                interval=(0.0, 1.0),
                standard_error=0.01,
                n_eff=20.0,
                n_carrying=int(np.nansum(z > 0)),
                largest_weight_share=0.1,
                aimed=name == problem.aim,
            )
            for name, z in zip(problem.consequences, told[:, 1:].T, strict=True)
        )
        p = float(np.nanmean(told[:, 0]))
        snapshot = Snapshot(probability=p, interval=(0.0, 1.0), consequences=found)
    return replace(snapshot, stop_reason=StopReason.BUDGET_ENDED)


@pytest.fixture(autouse=True)
def method(monkeypatch):
    monkeypatch.setitem(methods.METHODS, "telling", adaptive)
    monkeypatch.setitem(methods.GOALS["probability"], "telling", adaptive)
    monkeypatch.setattr(methods, "TELL_CONSEQUENCES", ("telling",))


@pytest.fixture
def declared(scenario):
    return replace(Scenario.from_text(scenario.text + DECLARED, "small"), directory=None)


class Vehicle:
    """An event with two consequences; interrupted or wrong at the batch it is told to be."""

    def __init__(self, trouble=()):
        self.trouble, self.n_batches = dict(trouble), 0

    def __call__(self, x):
        self.n_batches += 1
        if (error := self.trouble.get(self.n_batches)) is not None:
            raise error
        depth = np.clip(x.sum(axis=1) - 1, 0, 1)
        return {"near miss": depth > 0, "severe": depth > 0.5, "injury": depth}


@pytest.fixture
def go(declared, traffic, monkeypatch):
    def go(out, vehicle=None, scenario=declared, **changes):
        simulate = vehicle or Vehicle()
        monkeypatch.setattr(Scenario, "simulator", lambda _: simulate)
        settings = {"seed": 3, "method": "telling", "max_calls": 60} | changes
        return run(scenario, traffic, out, **settings)

    return go


def test_result_and_record_hold_them(go, tmp_path):
    found = go(tmp_path, aim="injury")
    result, record = status(tmp_path), load_run(tmp_path)
    assert [c["name"] for c in result["consequences"]] == ["injury", "severe"]
    assert result["consequences"][0]["mean"] == found.consequences[0].mean
    assert result["consequences"][0]["aimed"]
    assert result["target"]["aim"] == "injury"
    assert record.consequences.shape == (60, 2)
    np.testing.assert_array_equal(record.consequences[:, 0] > 0, record.outcomes == 1)


@pytest.mark.parametrize("at", [1, 3, 6])
def test_an_interrupted_run_goes_on_to_the_same_bits(go, tmp_path, at):
    whole = go(tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        go(tmp_path / "cut", Vehicle({at: KeyboardInterrupt()}))
    assert go(tmp_path / "cut") == whole
    texts = [(tmp_path / d / "result.json").read_text() for d in ("whole", "cut")]
    assert texts[0] == texts[1]


def test_a_batch_cut_by_the_budget_is_completed(go, tmp_path):
    go(tmp_path / "grown", max_calls=45)
    assert go(tmp_path / "grown") == go(tmp_path / "whole")


def test_they_are_part_of_what_a_run_is(go, tmp_path, declared, scenario):
    go(tmp_path)
    with pytest.raises(StoreError, match='aim: has "the event", asked for "injury"'):
        go(tmp_path, aim="injury")
    other = replace(
        Scenario.from_text(declared.text.replace(', "severe"', ""), "small"), directory=None
    )
    with pytest.raises(StoreError, match=r"\[outcome\] consequences"):
        go(tmp_path, scenario=other)
    with pytest.raises(StoreError, match=r"\[outcome\] consequences"):
        go(tmp_path, scenario=scenario)


def test_a_folder_from_before_consequences_still_opens(scenario, traffic, tmp_path, monkeypatch):
    monkeypatch.undo()
    with RunStore.create(tmp_path / "old", {"seed": "0"}) as store:
        store.append(0, Batch(np.ones((2, 2)), np.array([1.0, 0.0])))
        (batch,) = store.batches(2)
    np.testing.assert_array_equal(batch.outcomes, [1.0, 0.0])
    monkeypatch.setattr(Scenario, "simulator", lambda _: lambda x: x.sum(axis=1) > 1)
    settings = {"method": "crude", "max_calls": 20}
    run(scenario, traffic, tmp_path / "run", **settings)
    with RunStore.open(tmp_path / "run") as store, store._transaction() as connection:
        connection.execute("DELETE FROM config WHERE key = 'aim'")
    run(scenario, traffic, tmp_path / "run", **(settings | {"max_calls": 30}))
    result = json.loads((tmp_path / "run" / "result.json").read_text())
    del result["consequences"]
    (tmp_path / "run" / "result.json").write_text(json.dumps(result))
    assert load_run(tmp_path / "run").consequences.shape == (30, 0)


def test_a_store_of_other_width_is_damaged(tmp_path):
    with RunStore.create(tmp_path, {}) as store:
        store.append(0, Batch(np.ones((2, 2)), np.zeros((2, 3))))
        assert store.batches(2, 2)[0].outcomes.shape == (2, 3)
        with pytest.raises(StoreError, match="damaged: expected 2 rows of 2 variables in batch 0"):
            store.batches(2)


def test_what_a_vehicle_tells_is_checked_before_it_is_stored(go, tmp_path):
    with pytest.raises(SimulationError, match="keys injury, severe and one more"):
        go(tmp_path, lambda x: {"near miss": x[:, 0] > 0})
    with pytest.raises(SimulationError, match="divide"):
        go(tmp_path, lambda x: np.tile([1, 3.0, 0], (len(x), 1)))
    assert go(tmp_path).n_calls == 60


def test_a_mapping_without_a_declaration_says_where_to_declare(go, tmp_path, scenario):
    with pytest.raises(SimulationError, match=r"\[outcome\] consequences"):
        go(tmp_path, scenario=scenario)


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ('[outcome]\nconsequences = "injury"', "consequences: expected a list of texts"),
        ('[outcome]\nconsequences = ["a", "a"]', "expected different names"),
        ('[outcome]\nconsequences = ["crash"]', "other names than that of the event, 'crash'"),
        ('[outcome]\nevent = " "', "event: expected a word for the answer's sentence, got ' '"),
        ('[outcome]\nper = ""', "per: expected a word"),
    ],
)
def test_what_is_wrong_in_a_scenario_is_refused(scenario, more, says):
    with pytest.raises(ScenarioError, match=says) as refused:
        Scenario.from_text(scenario.text + more)
    assert str(refused.value).count("[outcome]") == 1


def test_an_aim_without_consequences_says_where_to_declare_them(scenario):
    text = scenario.text.replace("[target]", '[target]\naim = "injury"')
    with pytest.raises(ScenarioError, match=r"'injury', and \[outcome\] declares no consequences"):
        Scenario.from_text(text)


def test_the_plant_of_the_study_tells_none(scenario):
    text = scenario.text.replace('"python"', '"acc-aeb"').replace(
        'function = "small_vehicle:crashes"\n', ""
    )
    with pytest.raises(ScenarioError, match="'acc-aeb' tells crashes alone"):
        simulator_of(Scenario.from_text(text + DECLARED))


def test_an_aim_must_be_declared(scenario, declared, go, tmp_path):
    text = declared.text.replace("[target]", '[target]\naim = "injuries"')
    with pytest.raises(ScenarioError, match="did you mean 'injury'"):
        Scenario.from_text(text)
    aims = Scenario.from_text(text.replace("injuries", "injury"))
    assert aims.target.aim == "injury"
    with pytest.raises(InvalidInputError, match="aim: expected one of"):
        go(tmp_path, aim="depth")
    at_the_event = go(tmp_path / "event", scenario=aims, aim="near miss")
    assert not any(c.aimed for c in at_the_event.consequences)
    assert scenario.target.aim is None
