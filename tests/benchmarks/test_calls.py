"""The cheap parts of benchmarks/calls.py: counting, what a failure becomes, the table, the plot."""

import importlib.util
import json
import sys
from types import SimpleNamespace

import numpy as np
import pytest

posix = pytest.mark.skipif(sys.platform == "win32", reason="the clock of a run is a POSIX timer")


def needs(*packages):
    missing = [name for name in packages if importlib.util.find_spec(name) is None]
    return pytest.mark.skipif(
        bool(missing), reason=f"{', '.join(missing)} not installed: pip install '.[bench]'"
    )


def line(method, problem="A", **values):
    return {
        "problem": problem,
        "method": method,
        "seed": 0,
        "package": "crashrate",
        "version": "0",
        "reference": 1e-6,
        "calls": 100,
        "probability": 1.1e-6,
        "interval": [0.9e-6, 1.3e-6],
        "covered": True,
        "error": None,
    } | values


def limit_state(name, **options):
    from peers.limit_state import LimitState
    from problems import PROBLEMS

    return LimitState(PROBLEMS[name](), **{"max_calls": 1000} | options)


def test_rows_are_counted_and_none_is_evaluated_beyond_the_budget():
    from peers.limits import BudgetError

    limit = limit_state("B", max_calls=10)
    limit(np.zeros((4, 3)))
    limit(np.zeros(3))
    assert limit.n_calls == 5
    with pytest.raises(BudgetError, match="more than 10 calls"):
        limit(np.zeros((6, 3)))
    assert limit.n_calls == 5
    assert limit.ended == "more than 10 calls"


@pytest.mark.parametrize("name", ["B", "C"])
def test_limit_state_is_the_problem_in_other_variables(name):
    from problems import PROBLEMS
    from standard_space import StandardSpace

    given, limit = PROBLEMS[name](), limit_state(name, max_calls=10**6)
    space = StandardSpace.of(given.traffic)
    u = 2 * np.random.default_rng(0).standard_normal((20_000, 3))
    x = space.to_situations(u)
    crash = given.traffic.contains(x)
    crash[crash] = given.crash(x[crash])
    assert crash.sum() > 20
    assert np.array_equal(limit(u) <= 0, crash)
    outcomes = limit_state(name, max_calls=10**6, binary=True)
    assert np.array_equal(outcomes(u), np.where(crash, -1.0, 1.0))


def test_no_limit_state_without_a_margin():
    with pytest.raises(ValueError, match="margin"):
        limit_state("cut-in")


@posix
def test_a_campaign_is_counted_by_the_function_it_calls():
    import calls

    task = {
        "problem": "A",
        "method": "crashrate sequential",
        "seed": 1,
        "settings": {"target": 0.5, "max_calls": 60, "max_seconds": 300},
        "package": "crashrate",
        "version": "0",
    }
    record = calls.run_task(task)
    assert 20 <= record["calls"] <= 60
    assert record["error"] is None
    assert task.items() <= record.items()
    assert json.loads(json.dumps(record)) == record


@posix
def test_a_run_ends_with_its_seconds():
    from peers.limits import BudgetError, at_most

    def forever():
        while True:
            pass

    with pytest.raises(BudgetError, match=r"more than 0\.05 s"), at_most(0.05):
        forever()
    with at_most(100):
        pass


@posix
@pytest.mark.parametrize("problem", ["A", "disc"])
def test_what_a_peer_raises_is_a_result(monkeypatch, problem):
    import calls
    import peers

    def fails(limit, _seed, _settings):
        limit(np.zeros((7, 2)))
        raise RuntimeError("no\n  design point")

    peer = peers.Peer("broken", "crashrate", fails, {})
    monkeypatch.setattr(peers, "available", lambda: {"broken": peer})
    task = {
        "problem": problem,
        "method": "broken",
        "seed": 0,
        "settings": {"max_calls": 100, "max_seconds": 10},
        "package": "theirs",
        "version": "0",
    }
    record = calls.run_task(task)
    assert record["calls"] == 7
    assert record["error"] == "RuntimeError: no design point"
    assert not record["covered"]


def test_an_answer_of_zero_is_no_estimate_but_its_interval_may_cover():
    import calls
    from peers import Answer

    judged = calls._judged(Answer(0.0, 0.0, 1e-3), SimpleNamespace(probability=1e-6))
    assert judged["covered"]
    assert judged["error"] == "the answer is 0"
    assert not calls._judged(Answer(0.0, 0.0, 0.0), SimpleNamespace(probability=1e-6))["covered"]


def test_table():
    from calls_table import table

    records = [
        line("peer", calls=3000, probability=0.8e-6, interval=[0.7e-6, 0.9e-6], covered=False),
        line("peer", calls=1000, probability=1.0e-6, interval=[0.9e-6, 1.1e-6]),
        line("peer", problem="B", probability=None, interval=None, covered=False, error="raised"),
        line("crashrate sequential"),
    ]
    rows = table(records).splitlines()
    assert "| method | A | B |" in rows
    assert "| crashrate sequential | 100; ± 18 %; +10 / 10; 1/1 | – |" in rows
    assert "| peer | 2,000; ± 11 %; \N{MINUS SIGN}10 / 14; 1/2 | 100; no estimate; 0/1 |" in rows
    assert rows.index("| method | A | B |") + 2 == next(
        i for i, row in enumerate(rows) if row.startswith("| crashrate")
    )


@needs("matplotlib")
@pytest.mark.filterwarnings(
    "ignore::DeprecationWarning:pyparsing", "ignore::DeprecationWarning:matplotlib"
)
def test_plot_has_a_panel_for_every_problem(tmp_path):
    from calls_plot import plot

    records = [
        line("peer"),
        line("peer", problem="B", covered=False),
        line("other", probability=None, interval=None, error="raised", covered=False),
    ]
    plot(records, tmp_path / "calls.svg")
    plot(records, tmp_path / "again.svg")
    drawn = (tmp_path / "calls.svg").read_text(encoding="utf-8")
    assert drawn == (tmp_path / "again.svg").read_text(encoding="utf-8")
    assert all(f">{text}<" in drawn for text in ("A", "B", "peer", "other", "simulator calls"))


def test_missing_packages_are_named(monkeypatch):
    import peers

    monkeypatch.setattr(peers, "find_spec", lambda _name: None)
    assert peers.missing() == {
        "openturns_peers": "openturns",
        "pystra_peers": "pystra",
        "kriging": "openturns",
    }
    assert peers.available() == {}


@needs("openturns", "pystra")
@pytest.mark.filterwarnings("ignore")  # those of other projects
@pytest.mark.parametrize("name", ["OpenTURNS FORM + IS", "pystra FORM + IS"])
def test_importance_sampling_at_the_design_point_of_a_half_plane(name):
    import peers
    from problems import PROBLEMS

    reference, ratios = PROBLEMS["A"]().probability, []
    for seed in range(4):
        limit = limit_state("A", max_calls=20_000)
        peer = peers.available()[name]
        answer = peer.run(limit, seed, peer.settings)
        ratios.append(answer.probability / reference)
        assert 1000 < limit.n_calls < 4000
    assert np.mean(ratios) == pytest.approx(1, abs=4 * 0.051 / 2)
    assert len(set(ratios)) == 4


def study_options(out, **options):
    defaults = {
        "seeds": range(1),
        "problem": ["A"],
        "method": ["crashrate sequential"],
        "target": 0.5,
        "max_calls": 40,
        "peer_calls": 1000,
        "max_seconds": 300.0,
        "processes": 1,
        "again": False,
        "out": out,
    }
    return SimpleNamespace(**defaults | options)


@posix
def test_a_study_is_taken_up_and_run_again(monkeypatch, tmp_path):
    import calls

    ran = []

    def once(_run, tasks, path, _processes, _progress):
        ran.append([task["seed"] for task in tasks])
        with path.open("a", encoding="utf-8") as out:
            out.writelines(json.dumps(line(**task)) + "\n" for task in tasks)

    monkeypatch.setattr(calls, "study", once)
    monkeypatch.setattr(calls.peers, "available", dict)
    out = tmp_path / "calls.jsonl"
    calls.run(study_options(out))
    calls.run(study_options(out, seeds=range(3)))
    calls.run(study_options(out, seeds=range(2), again=True))
    calls.run(study_options(out, max_calls=50))
    assert ran == [[0], [1, 2], [0, 1], [0]]
    with pytest.raises(SystemExit, match="expected some of crashrate sequential"):
        calls.run(study_options(out, method=["magic"]))
