import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from crashrate import datasets
from crashrate.cli import Method, app
from crashrate.errors import InvalidInputError
from crashrate.estimation import methods
from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.estimation.strategy import Query, Snapshot
from crashrate.runs import demo
from crashrate.runs.record import load_run
from crashrate.runs.scenario import Scenario
from crashrate.runs.store import RunStore
from crashrate.traffic.model import TrafficModel

ROOT = Path(__file__).resolve().parents[1]
HUANG = ROOT / "examples" / "huang2017.toml"
COMMANDS = ("fit", "run", "status", "report", "demo")
SCENARIO = """
[variables.a]
lower = 0
[variables.b]
[simulator]
kind = "python"
function = "{module}:crashes"
[target]
max_calls = 4
"""


def crashrate(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def error_line(result):
    """The one line of a refused command: no traceback, nothing on standard output."""
    assert result.stdout == ""
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("Error: ")
    return lines[0]


def three_batches(problem):
    """A stand-in for a method: three batches, then what it was told to find."""
    found = Snapshot(
        probability=0.25,
        interval=(0.2, 0.3),
        alarms=(Alarm.WEIGHTS_CONCENTRATED,),
        stop_reason=StopReason.TARGET_MET if problem.max_calls > 12 else StopReason.BUDGET_ENDED,
    )
    for k in range(3):
        yield Query(problem.traffic.sample(4, problem.rng(k)), Snapshot())
    return found


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setitem(methods.METHODS, "sequential", three_batches)


@pytest.fixture
def small(tmp_path):
    """A scenario with a vehicle of its own beside it, and a traffic model."""
    module = f"vehicle_{abs(hash(tmp_path))}"
    (tmp_path / f"{module}.py").write_text("def crashes(x):\n    return x[:, 0] > 1\n")
    (tmp_path / "small.toml").write_text(SCENARIO.format(module=module))
    TrafficModel(
        [1.0], [[0.5, 0.0]], [np.eye(2)], [0.0, -np.inf], [np.inf] * 2, ("a", "b")
    ).to_json(tmp_path / "traffic.json")
    return tmp_path


def small_run(small, *more):
    out = small / "run"
    return crashrate(
        "run", small / "small.toml", "--traffic", small / "traffic.json", "--out", out, *more
    )


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_every_command_has_examples(command):
    shown = crashrate(command, "--help")
    assert shown.exit_code == 0
    assert f"    crashrate {command}" in shown.stdout.split("Example")[1]


def test_a_batch_is_as_large_as_asked_for_and_stays_so(small):
    crude = ("--method", "crude", "--max-calls", "21")
    assert small_run(small, *crude, "--batch-size", "7").exit_code in (0, 3)
    with RunStore.open(small / "run") as store:
        assert {len(batch.x) for batch in store.batches(2)} == {7}
    refused = small_run(small, *crude, "--batch-size", "8")
    assert refused.exit_code == 1
    assert "batch_size" in error_line(refused)


def test_version_and_help():
    assert crashrate("--version").stdout.startswith("crashrate 0.")
    assert all(command in crashrate("--help").stdout for command in COMMANDS)


def test_command_line_starts_without_heavy_imports():
    code = (
        "import sys, crashrate.cli\n"
        "print([m for m in ('scipy', 'sklearn', 'plotly', 'pyarrow', 'jinja2', 'numpy') "
        "if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert set(json.loads(done.stdout.replace("'", '"'))) <= {"numpy"}


@pytest.mark.parametrize(
    "arguments",
    [
        ["fly"],
        ["run"],
        ["run", HUANG, "--traffic", "published"],
        ["run", HUANG, "--traffic", "published", "--out", "x", "--method", "magic"],
        ["run", HUANG, "--traffic", "published", "--out", "x", "--max-calls", "0"],
        ["run", HUANG, "--traffic", "published", "--out", "x", "--relative-half-width", "0"],
        ["run", HUANG, "--traffic", "published", "--out", "x", "--seed", "-1"],
        ["run", HUANG, "--traffic", "published", "--out", "x", "--format", "xml"],
        ["fit", "x.csv", "--scenario", HUANG, "--out", "t.json", "--components", "3:1"],
        ["run", HUANG, "--traffic", "published", "--out", "x", "--relative-half-width", "10"],
        ["demo", "--seed", "one"],
        ["status"],
    ],
)
def test_wrong_usage_leaves_with_2(arguments):
    refused = crashrate(*arguments)
    assert refused.exit_code == 2
    assert "Error: " in refused.stderr
    assert "Traceback" not in refused.stderr


def test_missing_and_wrong_files_leave_with_1(tmp_path):
    out = tmp_path / "out"
    refused = crashrate("run", tmp_path / "no.toml", "--traffic", "published", "--out", out)
    assert refused.exit_code == 1
    assert "no.toml: expected a scenario file" in error_line(refused)
    refused = crashrate("run", HUANG, "--traffic", tmp_path / "no.json", "--out", out)
    assert refused.exit_code == 1
    assert "no.json" in error_line(refused)
    refused = crashrate("status", tmp_path)
    assert refused.exit_code == 1
    assert "expected a run folder" in error_line(refused)
    assert not out.exists()


def test_published_traffic_of_other_variables_is_refused(small):
    refused = crashrate(
        "run", small / "small.toml", "--traffic", "published", "--out", small / "run"
    )
    assert refused.exit_code == 1
    assert "(a, b), got (v_lead, inv_range, inv_ttc); fit one" in error_line(refused)


def test_debug_shows_the_traceback(tmp_path):
    shown = crashrate("--debug", "status", tmp_path)
    assert type(shown.exception).__name__ == "StoreError"


def test_bug_is_one_line_that_asks_for_a_report(small, quick, monkeypatch):
    del quick
    monkeypatch.setattr(Scenario, "simulator", lambda _: lambda _: 1 / 0)
    refused = small_run(small)
    assert refused.exit_code == 1
    assert "unexpected ZeroDivisionError: division by zero. Please report" in error_line(refused)


def test_target_met_leaves_with_0_and_the_sentence(small, quick):
    del quick
    done = small_run(small, "--max-calls", "20")
    assert done.exit_code == 0
    assert done.stdout.startswith(
        "P(crash) = 2.5e-01 per encounter, 95 % Monte Carlo interval [2.0e-01, "
    )
    assert len(done.stdout.splitlines()) == 1
    assert f"Alarm: {Alarm.WEIGHTS_CONCENTRATED}." in done.stderr
    assert "Stopped: the target was met. Target ± 10 %, 12 of at most 20 runs taken." in done.stderr
    assert "ynthetic" not in done.output
    page = (small / "run" / "report.html").read_text()
    assert "per encounter, 95 % Monte Carlo interval" in page


METHODS = ("sequential", "huang2017", "crude", "cross-entropy")


def test_every_method_has_a_name_on_the_command_line():
    assert tuple(method.value for method in Method) == METHODS == tuple(methods.METHODS)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_runs_goes_on_and_reports(small, method):
    text = (small / "small.toml").read_text()
    (small / "small.toml").write_text(text + '[risk]\na = "increasing"\n')
    asked = ("--method", method, "--max-calls", "50", "--relative-half-width", "0.05")
    first, again = small_run(small, *asked), small_run(small, *asked, "--format", "json")
    assert first.exit_code == again.exit_code in {0, 3}
    assert json.loads(again.stdout)["method"] == method
    assert 20 < json.loads(again.stdout)["n_calls"] <= 50
    assert "0 new simulator runs" in again.stderr
    assert crashrate("status", small / "run").exit_code == 0
    assert crashrate("report", small / "run").exit_code == 0
    assert method in (small / "run" / "report.html").read_text()


@pytest.mark.parametrize("method", ["crude", "cross-entropy"])
def test_a_larger_budget_goes_on_with_what_is_stored(small, method):
    for folder, budgets in (("run", (30, 150, 1500)), ("at once", (1500,))):
        for budget in budgets:
            done = crashrate(
                "run", small / "small.toml", "--traffic", small / "traffic.json", "--out",
                small / folder, "--method", method, "--max-calls", budget, "--format", "json",
            )  # fmt: skip
    assert done.exit_code in {0, 3}
    both = [
        {
            k: v
            for k, v in json.loads((small / folder / "result.json").read_text()).items()
            if k != "history"
        }
        for folder in ("run", "at once")
    ]
    assert both[0] == both[1]


def test_the_scenario_names_the_method_and_the_command_line_another(small):
    text = (small / "small.toml").read_text()
    (small / "small.toml").write_text(text + 'method = "crude"\n')
    assert json.loads(small_run(small, "--format", "json").stdout)["method"] == "crude"
    other = small_run(small, "--method", "cross-entropy")
    assert 'method: has "crude", asked for "cross-entropy"' in error_line(other)


def test_what_a_simulator_prints_is_not_the_answer(small, quick):  # noqa: ARG001
    (module,) = small.glob("vehicle_*.py")
    module.write_text("def crashes(x):\n    print('hello')\n    return x[:, 0] > 1\n")
    done = small_run(small, "--format", "json")
    assert json.loads(done.stdout)["n_calls"] == 12
    assert "hello" in done.stderr


def test_budget_ended_leaves_with_3(small, quick):
    del quick
    done = small_run(small)
    assert done.exit_code == 3
    assert "Stopped: the budget of simulator runs ended." in done.stderr
    assert f"Alarm: {Alarm.TARGET_NOT_REACHED}." in done.stderr


def test_bounds_are_printed_with_the_audit_of_their_order(small):
    text = (small / "small.toml").read_text()
    (small / "small.toml").write_text(text.replace("= 4", '= 40\n[risk]\na = "increasing"'))
    done = small_run(small, "--goal", "bounds", "--relative-half-width", "0.001")
    assert done.stdout.startswith("bounds if the risk order holds: ")
    assert done.stdout.splitlines()[1].startswith("audit of the order: of ")
    assert "not estimated" in (small / "run" / "report.html").read_text()
    refused = small_run(small)
    assert refused.exit_code == 1
    assert 'goal: has "bounds", asked for "probability"' in error_line(refused)


def test_json_is_pure_and_the_same_everywhere(small, quick):
    del quick
    done = json.loads(small_run(small, "--format", "json").stdout)
    stored = json.loads((small / "run" / "result.json").read_text())
    shown = json.loads(crashrate("status", small / "run", "--format", "json").stdout)
    assert done == stored
    assert shown.pop("seconds_since_stored") >= 0
    assert shown == stored | {"running": False, "n_stored": stored["n_calls"]}
    assert done["schema"] == "crashrate.result/1"
    assert done["alarms"][0]["name"] == "WEIGHTS_CONCENTRATED"


def test_status_and_report_read_what_is_there(small, quick):
    del quick
    sentence = small_run(small).stdout
    (small / "run" / "report.html").unlink()
    assert crashrate("status", small / "run").stdout == sentence
    written = crashrate("report", small / "run")
    assert Path(written.stdout.strip()) == small / "run" / "report.html"
    assert (small / "run" / "report.html").is_file()


def test_resumed_run_says_what_it_took_from_the_folder(small, quick):
    del quick
    assert "taken from" not in small_run(small).stderr
    again = small_run(small, "--max-calls", "20")
    assert f"12 outcomes taken from {small / 'run'}, 0 new simulator runs." in again.stderr


def test_same_command_is_answered_again_and_a_smaller_budget_refused(small, quick):
    del quick
    first = small_run(small, "--max-calls", "20")
    assert small_run(small, "--max-calls", "20").stdout == first.stdout
    refused = small_run(small, "--max-calls", "11")
    assert refused.exit_code == 1
    assert "holds 12 simulator runs, more than the budget of 11" in error_line(refused)
    assert crashrate("status", small / "run").stdout == first.stdout


def test_report_that_fails_does_not_hide_the_answer(small, quick, monkeypatch):
    del quick
    monkeypatch.setattr("crashrate.reports.html.render_report", lambda _: 1 / 0)
    done = small_run(small)
    assert done.exit_code == 1
    assert done.stdout.startswith("P(crash) = 2.5e-01")
    assert "unexpected ZeroDivisionError" in done.stderr


def test_status_of_an_unfinished_run_says_how_to_go_on(small, quick, monkeypatch):
    del quick

    def stop(_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Scenario, "simulator", lambda _: stop)
        assert small_run(small).exit_code == 130
    shown = crashrate("status", small / "run")
    assert "Not finished; the same `run` command goes on." in shown.stderr


def test_status_counts_what_is_stored_though_the_result_is_older(small, quick):
    del quick
    assert small_run(small).exit_code == 3
    path = small / "run" / "result.json"
    older = json.loads(path.read_text()) | {"n_calls": 8}
    path.write_text(json.dumps(older))  # as a process that is killed leaves it
    shown = crashrate("status", small / "run")
    assert " runs taken. The answer above is of the first 8 of them." in shown.stderr
    assert json.loads(crashrate("status", small / "run", "--format", "json").stdout)["n_stored"] > 8


def test_run_folder_that_is_a_file_is_refused_in_plain_words(small):
    (small / "run").write_text("")
    refused = small_run(small)
    assert refused.exit_code == 1
    assert "run is a file; choose another --out" in error_line(refused)


def test_other_configuration_is_refused(small, quick):
    del quick
    assert small_run(small).exit_code == 3
    refused = small_run(small, "--seed", "1")
    assert refused.exit_code == 1
    assert 'seed: has "0", asked for "1"' in error_line(refused)


@pytest.mark.parametrize("signal", ["SIGINT", "SIGKILL"])
def test_stopped_by_a_signal_and_resumed_gives_the_same_bits(small, signal):
    """A real process, with the real method: the vehicle itself sends the signal, once."""
    (module,) = small.glob("vehicle_*.py")
    module.write_text(
        "import os, pathlib, signal\n"
        # a shell's background jobs, this test's too, inherit that SIGINT is ignored
        "if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:\n"
        "    signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "def crashes(x):\n"
        f"    once = pathlib.Path({str(small / 'once')!r})\n"
        "    if once.exists() and once.read_text().count('x') == 1:\n"
        "        once.unlink()\n"
        f"        os.kill(os.getpid(), signal.{signal})\n"
        "    if once.exists():\n"
        "        once.write_text(once.read_text() + 'x')\n"
        "    return x[:, 0] > 1\n"
    )

    def go(out):
        command = ["run", "small.toml", "--traffic", "traffic.json", "--out", out]
        return subprocess.run(
            [sys.executable, "-m", "crashrate.cli", *command],
            cwd=small,
            capture_output=True,
            text=True,
            check=False,
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        )

    assert go("whole").returncode == 3
    (small / "once").write_text("")
    stopped = go("cut")
    assert stopped.returncode == (130 if signal == "SIGINT" else -9)
    assert "Traceback" not in stopped.stderr
    resumed = go("cut")
    assert resumed.returncode == 3
    texts = [(small / out / "result.json").read_text() for out in ("whole", "cut")]
    assert texts[0] == texts[1]


# --- fit

SHORT = ("--ensemble", "0", "--restarts", "1", "--workers", "1")


@pytest.fixture
def events(tmp_path):
    x = datasets.spmd_mixture().sample(400, 1)
    x[:3, 2] *= -1  # not closing
    path = tmp_path / "events.csv"
    np.savetxt(path, x, delimiter=",", header="v_lead,inv_range,inv_ttc", comments="")
    return path


def test_fit_by_default_tries_four_starts_and_carries_forty_further_fits(
    events, tmp_path, monkeypatch
):
    given = {}

    def fit_traffic(*_, **options):
        given.update(options)
        raise InvalidInputError("enough")

    monkeypatch.setattr("crashrate.runs.fitting.fit_traffic", fit_traffic)
    crashrate("fit", events, "--scenario", HUANG, "--out", tmp_path / "t.json")
    assert given["n_restarts"] == 4
    assert given["n_members"] == 40
    assert given["workers"] is None  # as many as are worth it


def test_fit_prints_what_was_dropped_and_the_criterion(events, tmp_path):
    out = tmp_path / "traffic.json"
    done = crashrate(
        "fit", events, "--scenario", HUANG, "--components", "1:2", "--out", out, *SHORT
    )
    assert done.exit_code == 0
    assert "397 events of 400 rows; dropped: 3 not closing" in done.stdout
    assert done.stdout.count("lowest") == 1
    model = TrafficModel.from_json(out)
    assert model.provenance["events"]["dropped"] == {"not closing": 3}
    assert model.provenance["events"]["synthetic"] is False
    assert model.provenance["selection"]["n_components"] == [1, 2]
    assert np.shape(model.provenance["selection"]["held_out"]) == (2, 1)
    assert model.members == ()
    assert model.names == ("v_lead", "inv_range", "inv_ttc")


def test_fit_refuses_a_place_before_it_fits_and_makes_a_missing_folder(events, tmp_path):
    command = ["fit", events, "--scenario", HUANG, *SHORT, "--components", "1", "--out"]
    refused = crashrate(*command, tmp_path)
    assert refused.exit_code == 1
    assert "expected a file to write, found a folder" in error_line(refused)
    assert crashrate(*command, tmp_path / "new" / "folder" / "t.json").exit_code == 0


def test_fit_replaces_traffic_models_only(events, tmp_path):
    command = ["fit", events, "--scenario", HUANG, *SHORT, "--components", "1", "--out"]
    before = events.read_text()
    refused = crashrate(*command, events)
    assert refused.exit_code == 1
    assert "a traffic model to replace; this file is something else" in error_line(refused)
    assert events.read_text() == before
    assert [crashrate(*command, tmp_path / "t.json").exit_code for _ in "ab"] == [0, 0]


def test_fit_with_further_fits_keeps_them_and_tells_of_the_end_of_the_range(events, tmp_path):
    out = tmp_path / "traffic.json"
    done = crashrate(
        "fit", events, "--scenario", HUANG, "--components", "1:2", "--ensemble", "3",
        "--restarts", "2", "--workers", "1", "--out", out,
    )  # fmt: skip
    assert done.exit_code == 0
    assert "with 3 further fits" in done.stdout
    assert "spread over starts" in done.stdout
    assert "not identified" not in done.stdout
    assert "Warning: BIC is lowest at 2, the most components that were tried" in done.stderr
    model = TrafficModel.from_json(out)
    assert len(model.members) == 4
    assert np.shape(model.provenance["selection"]["bic_restarts"]) == (2, 2)


def test_fit_tells_of_too_few_events(events, tmp_path):
    command = ["fit", events, "--scenario", HUANG, *SHORT]
    command += ["--out", tmp_path / "t.json", "--components"]
    refused = crashrate(*command, "40")
    assert refused.exit_code == 1
    assert "at least 10 events for each of 40 components, got 397 events" in error_line(refused)
    assert "smaller --components (up to 39, better fewer)" in error_line(refused)
    few = crashrate(*command, "5")
    assert "Warning: 397 events for the 49 free parameters of 5 components" in few.stderr
    assert "Warning" not in crashrate(*command, "1").stderr


def test_fit_of_the_recommended_cut_in_reads_the_same_file(events, tmp_path):
    out, scenario = tmp_path / "traffic.json", ROOT / "examples" / "cut_in.toml"
    done = crashrate(
        "fit", events, "--scenario", scenario, "--components", "1", "--out", out, *SHORT
    )
    assert done.exit_code == 0
    assert "BIC" not in done.stdout
    assert TrafficModel.from_json(out).names == ("v_lead", "inv_range", "closing_speed")


def test_fit_refuses_bad_rows_unless_told_to_drop_them(events, tmp_path):
    with events.open("a") as file:
        file.write("99,0.02,0.1\n")
    command = ["fit", events, "--scenario", HUANG, *SHORT]
    command += ["--components", "1", "--out", tmp_path / "t"]
    refused = crashrate(*command)
    assert refused.exit_code == 1
    line = error_line(refused)
    assert str(events) in line
    assert "99.0" in line
    assert "1 with v_lead out of bounds" in crashrate(*command, "--drop-invalid").stdout


# --- demo


@pytest.fixture
def short_demo(monkeypatch, quick):
    del quick
    table = demo.demo_events(0)
    short = replace(table, values=table.values[:600], rows=table.rows[:600])
    monkeypatch.setattr(demo, "demo_events", lambda _: short)
    monkeypatch.setattr(demo, "N_COMPONENTS", 2)


def test_demo_says_synthetic_wherever_its_events_appear(short_demo, tmp_path):
    del short_demo
    done = crashrate("demo", "--seed", "2", "--out", tmp_path / "demo")
    assert done.exit_code == 0
    assert done.stdout.startswith("P(crash) = ")
    assert len(done.stdout.splitlines()) == 1
    assert "synthetic events" in done.stderr
    result = json.loads((tmp_path / "demo" / "result.json").read_text())
    assert result["synthetic"] is True
    assert "synthetic" in result["traffic"]["events"]["source"]
    assert result["seed"] == 2
    assert "synthetic" in (tmp_path / "demo" / "report.html").read_text()


def test_demo_fits_once_in_one_process(short_demo, tmp_path):
    del short_demo
    crashrate("demo", "--out", tmp_path / "demo")
    provenance = load_run(tmp_path / "demo").traffic.provenance
    assert np.shape(provenance["selection"]["bic_restarts"]) == (1, 1)
    assert provenance["selection"]["held_out"] == []


def test_demo_again_gives_the_same_answer_from_the_store(short_demo, tmp_path):
    del short_demo
    first, again = (crashrate("demo", "--out", tmp_path / "demo") for _ in range(2))
    assert first.stdout == again.stdout


def test_demo_folder_is_named_after_its_seed(short_demo, tmp_path, monkeypatch):
    del short_demo
    monkeypatch.chdir(tmp_path)
    crashrate("demo", "--seed", "5")
    assert (tmp_path / "runs" / "demo-5" / "result.json").is_file()


def test_a_simulator_that_only_fails_is_an_error(tmp_path, monkeypatch):
    own = Path(__file__).resolve().parents[1] / "examples" / "own_vehicle.toml"
    text = own.read_text(encoding="utf-8").replace("my_vehicle:", "broken_vehicle:")
    (tmp_path / "own.toml").write_text(text, encoding="utf-8")
    source = "def simulate(x):\n    return [float('nan')] * len(x)\n"
    (tmp_path / "broken_vehicle.py").write_text(source, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    arguments = ["run", "own.toml", "--traffic", "published", "--out", "out"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 1
    assert "all 20 simulations failed" in result.output


def test_consequences_are_declared_aimed_at_and_printed(small, quick, monkeypatch):  # noqa: ARG001
    (scenario,) = small.glob("small.toml")
    scenario.write_text(scenario.read_text() + '[outcome]\nconsequences = ["injury"]\n')
    (vehicle,) = small.glob("vehicle_*.py")
    vehicle.write_text(
        "def crashes(x):\n"
        "    crash = x[:, 0] > 1\n"
        "    return {'crash': crash, 'injury': crash * 0.5}\n"
    )
    told = small_run(small, "--aim", "injury")
    assert told.exit_code == 3, told.stderr
    lines = told.stdout.splitlines()
    assert lines[0].startswith("E(injury) ≤ 3.0e-01 per encounter: not determined")
    assert lines[1].startswith("P(crash) = ")
    assert load_run(small / "run").result["consequences"][0]["aimed"]
    assert "expected one of" in small_run(small, "--aim", "injuries").stderr
