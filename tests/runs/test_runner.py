import json
import sqlite3
import sys
from dataclasses import replace

import numpy as np
import pytest

from crashrate.errors import InvalidInputError, SimulationError, StoreError
from crashrate.estimation import methods
from crashrate.estimation.campaign import Campaign
from crashrate.runs import vehicle as vehicle_module
from crashrate.runs.record import load_run
from crashrate.runs.runner import n_stored, run, status
from crashrate.runs.scenario import Scenario
from crashrate.traffic.model import TrafficModel

REQUIRED_KEYS = {
    "schema", "probability", "interval", "confidence", "relative_half_width", "n_calls",
    "n_crashes", "n_eff", "bounds", "crude_monte_carlo_calls", "acceleration", "alarms",
    "stop_reason", "seed", "method", "versions",
}  # fmt: skip
SETTINGS = dict(seed=3, method="small", relative_half_width=0.01, max_calls=60)
N_BATCHES = 6


def result_text(directory):
    return (directory / "result.json").read_text()


@pytest.fixture
def go(scenario, traffic):
    """Run the small problem in a folder, with the settings above or others."""

    def go(directory, **changes):
        return run(scenario, traffic, directory, **(SETTINGS | changes))

    return go


@pytest.fixture
def uninterrupted(go, tmp_path):
    directory = tmp_path / "whole"
    go(directory)
    return directory


def test_result_holds_every_promised_key(uninterrupted):
    result = json.loads(result_text(uninterrupted))
    assert set(result) >= REQUIRED_KEYS
    assert set(result["versions"]) == {"crashrate", "numpy", "scipy", "python"}
    assert result["n_calls"] == 60
    assert result["synthetic"] is False
    now = status(uninterrupted)
    assert 0 <= now.pop("seconds_since_stored") < 600
    assert now == result | {"running": False, "n_stored": 60}
    assert isinstance(result["notes"], list)


def test_estimate_is_that_of_a_campaign_alone(go, scenario, traffic, tmp_path, vehicle):
    found = go(tmp_path / "run")
    campaign = Campaign(traffic, risk=scenario.risk_mapping(), **SETTINGS)
    while not campaign.done:
        campaign.tell(vehicle(campaign.ask()))
    assert found == campaign.estimate()


@pytest.mark.parametrize("at", range(1, N_BATCHES + 1))
def test_interrupted_in_the_simulator_gives_the_same_bits(go, tmp_path, uninterrupted, vehicle, at):
    vehicle.trouble = {vehicle.n_batches + at: KeyboardInterrupt()}
    with pytest.raises(KeyboardInterrupt):
        go(tmp_path / "cut")
    assert status(tmp_path / "cut")["n_calls"] == 10 * (at - 1)
    before = vehicle.n_runs
    go(tmp_path / "cut")
    assert vehicle.n_runs - before == 60 - 10 * (at - 1)  # nothing is simulated twice
    assert result_text(tmp_path / "cut") == result_text(uninterrupted)


@pytest.mark.parametrize("at", range(1, N_BATCHES + 1))
def test_interrupted_while_thinking_gives_the_same_bits(
    go, tmp_path, uninterrupted, monkeypatch, at
):
    """The batch is stored, the campaign has not heard of it: the worst moment."""
    told = []

    def tell(self, outcomes, original=Campaign.tell):
        told.append(len(outcomes))
        if len(told) == at:
            raise KeyboardInterrupt
        original(self, outcomes)

    monkeypatch.setattr(Campaign, "tell", tell)
    with pytest.raises(KeyboardInterrupt):
        go(tmp_path / "cut")
    record = load_run(tmp_path / "cut")
    assert len(record.x) == record.result["n_calls"] == 10 * (at - 1)
    go(tmp_path / "cut")
    assert result_text(tmp_path / "cut") == result_text(uninterrupted)


@pytest.mark.parametrize("at", range(1, N_BATCHES + 1))
def test_interrupted_while_replaying_gives_the_same_bits(go, uninterrupted, at):
    def stop(standing):
        if standing.n_calls == 10 * at:
            raise KeyboardInterrupt

    before = result_text(uninterrupted)
    with pytest.raises(KeyboardInterrupt):
        go(uninterrupted, on_progress=stop)
    assert result_text(uninterrupted) == before
    go(uninterrupted)
    assert result_text(uninterrupted) == before


@pytest.mark.parametrize("first", [1, 7, 10, 34, 59, 60])
def test_raised_budget_goes_on_as_if_never_stopped(go, tmp_path, uninterrupted, vehicle, first):
    before = vehicle.n_runs
    go(tmp_path / "grown", max_calls=first)
    go(tmp_path / "grown")
    assert vehicle.n_runs - before == 60  # a batch that the budget cut is completed
    assert result_text(tmp_path / "grown") == result_text(uninterrupted)


def test_smaller_budget_is_refused_and_the_result_kept(go, uninterrupted, vehicle):
    before, n_runs = result_text(uninterrupted), vehicle.n_runs
    with pytest.raises(StoreError, match="holds 60 simulator runs, more than the budget of 34"):
        go(uninterrupted, max_calls=34)
    assert result_text(uninterrupted) == before
    go(uninterrupted)
    assert vehicle.n_runs == n_runs


def test_wider_target_is_answered_from_the_store(go, uninterrupted, vehicle):
    n_runs = vehicle.n_runs
    loose = go(uninterrupted, relative_half_width=0.8)
    assert loose.stop_reason.name == "TARGET_MET"
    assert loose.n_calls == 60  # nothing that is stored is left out
    assert go(uninterrupted).stop_reason.name == "BUDGET_ENDED"
    assert vehicle.n_runs == n_runs


def test_number_of_stored_runs(uninterrupted, tmp_path):
    assert n_stored(uninterrupted) == 60
    assert n_stored(tmp_path / "nowhere") == 0


@pytest.fixture
def own(scenario_file, monkeypatch):
    """The simulator of the scenario's folder itself, not the one that these tests count with."""
    monkeypatch.setattr(Scenario, "simulator", vehicle_module.simulator_of)
    yield scenario_file
    sys.modules.pop("small_vehicle", None)


def test_edited_simulator_is_refused_and_the_old_one_goes_on(own, traffic, tmp_path):
    def again():
        sys.modules.pop("small_vehicle", None)  # as a new process would
        return run(Scenario.from_file(own), traffic, tmp_path / "run", **SETTINGS)

    module = own.parent / "small_vehicle.py"
    text, first = module.read_text(), again()
    before = result_text(tmp_path / "run")
    module.write_text(text.replace("1.0", "-5.0"))
    with pytest.raises(StoreError, match=r"edited since.*another --out.*restore the file"):
        again()
    assert result_text(tmp_path / "run") == before
    module.write_text(text)
    assert again() == first
    module.write_text(text + "# mended\n")
    sys.modules.pop("small_vehicle", None)
    vouched = run(Scenario.from_file(own), traffic, tmp_path / "run", same_vehicle=True, **SETTINGS)
    assert vouched == first
    assert again() == first  # what was vouched for once is remembered
    (edit,) = json.loads(result_text(tmp_path / "run"))["vouched_sources"]
    assert edit["n_runs"] == 60


def test_simulator_mended_before_its_first_outcome_goes_on(own, traffic, tmp_path):
    module = own.parent / "small_vehicle.py"
    text = module.read_text()
    module.write_text("\ndef crashes(x):\n    raise OSError\n")
    with pytest.raises(SimulationError, match=r"small_vehicle.py, line 3\)"):
        run(Scenario.from_file(own), traffic, tmp_path / "run", **SETTINGS)
    sys.modules.pop("small_vehicle")
    module.write_text(text)
    run(Scenario.from_file(own), traffic, tmp_path / "run", **SETTINGS)
    run(Scenario.from_file(own), traffic, tmp_path / "run", **SETTINGS)


def test_run_begun_before_sources_were_kept_goes_on(own, traffic, tmp_path):
    scenario = Scenario.from_file(own)
    first = run(scenario, traffic, tmp_path / "run", **SETTINGS)
    with sqlite3.connect(tmp_path / "run" / "campaign.sqlite") as store:
        store.execute("DELETE FROM config WHERE key = 'simulator_source'")
    store.close()
    assert run(scenario, traffic, tmp_path / "run", **SETTINGS) == first


def test_other_version_of_the_simulator_is_refused(scenario, traffic, uninterrupted):
    text = scenario.text.replace("[target]", 'version = "2"\n[target]')
    with pytest.raises(StoreError, match=r"\[simulator\]: has .*\"version\": \"2\""):
        run(Scenario.from_text(text, scenario.name), traffic, uninterrupted, **SETTINGS)


def test_tightened_target_goes_on(go, tmp_path, vehicle):
    loose = go(tmp_path, relative_half_width=0.8)
    before = vehicle.n_runs
    tight = go(tmp_path)
    assert loose.stop_reason.name == "TARGET_MET"
    assert tight.n_calls == loose.n_calls + vehicle.n_runs - before == 60


def test_method_that_splits_its_budget_cannot_go_on(go, tmp_path, monkeypatch):
    def splitting(problem, steps=methods.METHODS["small"]):
        return steps(replace(problem, seed=problem.max_calls))

    monkeypatch.setitem(methods.METHODS, "small", splitting)
    go(tmp_path, max_calls=20)
    with pytest.raises(StoreError, match="aims at ± 1 % in 20 simulator runs; with the method"):
        go(tmp_path)
    go(tmp_path, max_calls=20)


def test_target_and_budget_default_to_the_scenario(scenario, traffic, tmp_path):
    run(scenario, traffic, tmp_path, seed=3, method="small")
    assert status(tmp_path)["target"] == {"relative_half_width": 0.3, "max_calls": 60, "aim": None}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"seed": 4}, 'seed: has "3", asked for "4"'),
        ({"method": "sequential"}, "method"),
        ({"batch_size": 20}, "batch_size"),
    ],
)
def test_other_configuration_is_refused(go, uninterrupted, change, says):
    with pytest.raises(StoreError, match="holds a run of another configuration") as raised:
        go(uninterrupted, **change)
    assert says in str(raised.value)
    assert "--out" in str(raised.value)


def test_other_goal_is_another_run(scenario, traffic, tmp_path):
    run(scenario, traffic, tmp_path / "run", max_calls=30)
    with pytest.raises(StoreError, match='goal: has "probability", asked for "bounds"'):
        run(scenario, traffic, tmp_path / "run", max_calls=30, goal="bounds")


def test_bounds_go_on_after_their_audit_when_the_budget_is_raised(scenario, traffic, tmp_path):
    def go(max_calls):
        return run(
            scenario,
            traffic,
            tmp_path / "run",
            goal="bounds",
            max_calls=max_calls,
            relative_half_width=1e-4,
            batch_size=5,
        )

    first = go(40)
    again = go(40)
    assert again == first
    assert first.order_audit is not None
    more = go(60)
    assert more.n_calls == 60
    assert more.bounds_factor <= first.bounds_factor
    result = status(tmp_path / "run")
    assert result["goal"] == "bounds"
    assert result["probability"] is None
    assert result["order_audit"]["sentence"].startswith("audit of the order: ")
    assert go(60) == more


def test_goal_defaults_to_that_of_the_scenario(scenario, traffic, tmp_path):
    text = scenario.text.replace("[target]", '[target]\ngoal = "bounds"')
    bounds = Scenario.from_text(text, scenario.name)
    assert bounds.target.goal == "bounds"
    got = run(bounds, traffic, tmp_path / "run", max_calls=20, relative_half_width=1e-3)
    assert got.goal == "bounds"


def test_other_scenario_is_refused_section_by_section(scenario, traffic, uninterrupted):
    other = Scenario.from_text(scenario.text.replace("a + b", "a + 2 * b"), scenario.name)
    with pytest.raises(StoreError, match=r"\[derived\]: has .*asked for"):
        run(other, traffic, uninterrupted, **SETTINGS)


def test_other_traffic_is_refused(scenario, traffic, uninterrupted):
    other = replace(traffic, means=traffic.means + 1e-12)
    other = replace(other, provenance={"events": {"source": "other.csv"}})
    says = r"has 1 component \(hash (\w+)\), asked for 1 .* from other.csv \(hash (?!\1)"
    with pytest.raises(StoreError, match=says):
        run(scenario, other, uninterrupted, **SETTINGS)


def test_comments_events_target_and_provenance_are_not_the_run(scenario, traffic, uninterrupted):
    text = scenario.text.replace("max_calls = 60", "max_calls = 50  # fewer")
    other = Scenario.from_text(text, "another_name")
    before = status(uninterrupted)
    got = run(
        other, replace(traffic, provenance={"note": "same numbers"}), uninterrupted, **SETTINGS
    )
    assert got.n_calls == before["n_calls"]
    assert got.probability == before["probability"]


def test_replay_that_parts_is_refused(go, uninterrupted):
    with sqlite3.connect(uninterrupted / "campaign.sqlite") as store:
        x = np.frombuffer(store.execute("SELECT x FROM batches WHERE k = 2").fetchone()[0]).copy()
        x[-1] = np.nextafter(x[-1], np.inf)  # one bit
        store.execute("UPDATE batches SET x = ? WHERE k = 2", (x.tobytes(),))
    store.close()
    with pytest.raises(StoreError, match="situations of batch 2 again"):
        go(uninterrupted)


def test_outcomes_come_from_the_store_not_from_the_simulator(go, uninterrupted):
    """Negative control of the replay: another stored outcome leads elsewhere, and is noticed."""
    with sqlite3.connect(uninterrupted / "campaign.sqlite") as store:
        y = np.frombuffer(store.execute("SELECT outcomes FROM batches WHERE k=0").fetchone()[0])
        store.execute("UPDATE batches SET outcomes = ? WHERE k = 0", ((1 - y).tobytes(),))
    store.close()
    with pytest.raises(StoreError, match="situations of batch 1 again"):
        go(uninterrupted)


@pytest.mark.parametrize("trouble", [SimulationError("engine fell off."), ValueError("bug")])
def test_failed_simulator_leaves_a_resumable_run(go, tmp_path, uninterrupted, vehicle, trouble):
    vehicle.trouble = {vehicle.n_batches + 3: trouble}
    with pytest.raises(type(trouble)) as raised:
        go(tmp_path / "cut")
    if isinstance(trouble, SimulationError):
        assert "The 20 simulator runs before are stored" in str(raised.value)
    assert status(tmp_path / "cut")["stop_reason"] == "not finished"
    go(tmp_path / "cut")
    assert result_text(tmp_path / "cut") == result_text(uninterrupted)


def test_odd_outcomes_are_not_stored(go, tmp_path, monkeypatch):
    monkeypatch.setattr(Scenario, "simulator", lambda _: lambda x: x[:, 0])
    with pytest.raises(SimulationError, match="expected booleans"):
        go(tmp_path)
    assert len(load_run(tmp_path).x) == 0


def test_failed_runs_are_outcomes(go, tmp_path, monkeypatch):
    monkeypatch.setattr(
        Scenario, "simulator", lambda _: lambda x: np.where(x[:, 0] > 1, np.nan, x[:, 1] > 0)
    )
    first = go(tmp_path)
    assert first.n_failed > 0
    assert go(tmp_path).n_failed == first.n_failed
    assert np.isnan(load_run(tmp_path).outcomes).sum() == first.n_failed


def test_other_variables_are_refused(scenario, traffic, tmp_path):
    named = replace(traffic, names=("a", "c"))
    with pytest.raises(InvalidInputError, match=r"\(a, b\), got \(a, c\)"):
        run(scenario, named, tmp_path / "run", **SETTINGS)
    boxed = TrafficModel([1.0], [[0.5, 0.0]], [np.eye(2)], [0.0, -5.0], [9.0, 5.0], ("a", "b"))
    with pytest.raises(InvalidInputError, match="lower = -inf for b, got -5"):
        run(scenario, boxed, tmp_path / "run", **SETTINGS)
    assert not (tmp_path / "run").exists()


def test_result_without_a_store_is_not_overwritten(go, tmp_path):
    (tmp_path / "result.json").write_text("precious")
    with pytest.raises(StoreError, match="expected a folder without a run"):
        go(tmp_path)
    assert result_text(tmp_path) == "precious"


def test_two_writers_are_noticed(go, tmp_path):
    def meddle(campaign):
        if campaign.n_calls == 20:
            with sqlite3.connect(tmp_path / "campaign.sqlite") as store:
                store.execute("INSERT INTO batches VALUES (2, 0, x'', x'')")
            store.close()

    with pytest.raises(StoreError, match="another process writes"):
        go(tmp_path, on_progress=meddle)


def test_a_second_run_in_the_same_folder_is_refused_before_it_simulates(go, tmp_path, vehicle):
    seen = []

    def meanwhile(campaign):
        if campaign.n_calls == 20:
            before = vehicle.n_runs
            with pytest.raises(StoreError, match="another process runs in this folder"):
                go(tmp_path)
            seen.append((vehicle.n_runs - before, status(tmp_path)["running"]))

    go(tmp_path, on_progress=meanwhile)
    assert seen == [(0, True)]
    assert status(tmp_path)["running"] is False


def test_a_refused_run_leaves_no_folder(go, tmp_path):
    with pytest.raises(InvalidInputError, match="batch_size"):
        go(tmp_path / "run", batch_size=0)
    assert not (tmp_path / "run").exists()


def test_where_locks_do_not_work_a_run_goes_on(go, tmp_path, uninterrupted, monkeypatch):
    def no_locks(*_, **__):
        raise NotImplementedError

    monkeypatch.setattr("filelock.FileLock.acquire", no_locks)
    go(tmp_path / "run")
    assert status(tmp_path / "run")["running"] is False
    assert result_text(tmp_path / "run") == result_text(uninterrupted)


def test_status_and_record_say_what_is_missing(tmp_path, uninterrupted):
    with pytest.raises(StoreError, match="expected a run folder"):
        status(tmp_path / "nowhere")
    (uninterrupted / "result.json").unlink()
    with pytest.raises(StoreError, match="no result yet"):
        load_run(uninterrupted)


@pytest.mark.parametrize("text", ["{", "[]", '{"schema": 1}', "\x00"])
def test_damaged_result_is_refused_and_written_again(go, uninterrupted, text):
    before = result_text(uninterrupted)
    (uninterrupted / "result.json").write_text(text)
    with pytest.raises(StoreError, match="damaged"):
        status(uninterrupted)
    go(uninterrupted)
    assert result_text(uninterrupted) == before


def test_record_is_what_was_run(scenario, traffic, uninterrupted):
    record = load_run(uninterrupted)
    assert record.directory == uninterrupted
    assert record.traffic == traffic
    assert record.scenario.fingerprint == scenario.fingerprint
    assert record.x.shape == (60, 2)
    np.testing.assert_array_equal(record.outcomes, record.x.sum(axis=1) > 1.0)
    assert not record.x.flags.writeable
    assert record.result["n_crashes"] == record.outcomes.sum()


def test_configuration_that_lost_a_part_is_refused(uninterrupted):
    with sqlite3.connect(uninterrupted / "campaign.sqlite") as store:
        store.execute("DELETE FROM config WHERE key = 'traffic'")
    store.close()
    with pytest.raises(StoreError, match="expected traffic in the configuration"):
        load_run(uninterrupted)


def test_folder_that_cannot_be_written_is_still_read(uninterrupted):
    for path in (*uninterrupted.iterdir(), uninterrupted):
        path.chmod(path.stat().st_mode & ~0o222)
    try:
        assert len(load_run(uninterrupted).x) == 60
    finally:
        uninterrupted.chmod(0o755)


def test_more_results_than_stored_is_refused(uninterrupted):
    result = json.loads(result_text(uninterrupted)) | {"n_calls": 61}
    (uninterrupted / "result.json").write_text(json.dumps(result))
    with pytest.raises(StoreError, match="expected the 61 simulator runs"):
        load_run(uninterrupted)


def test_synthetic_events_are_said(scenario, traffic, tmp_path):
    drawn = replace(traffic, provenance={"events": {"n": 5, "synthetic": True, "sample": [[1]]}})
    run(scenario, drawn, tmp_path, **SETTINGS)
    result = status(tmp_path)
    assert result["synthetic"] is True
    assert result["traffic"]["events"] == {"n": 5, "synthetic": True}
    assert load_run(tmp_path).synthetic


def test_traffic_model_on_another_scale_is_refused(scenario, traffic, tmp_path):
    logged = replace(traffic, scales=["log", "linear"])
    with pytest.raises(InvalidInputError, match=r"'linear' for a, got 'log'; fit one for this"):
        run(scenario, logged, tmp_path / "run", **SETTINGS)
