"""A small problem with a method of its own: enough to test everything around a campaign."""

from collections.abc import Generator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from crashrate.estimation import methods
from crashrate.estimation.alarms import StopReason
from crashrate.estimation.strategy import Problem, Query, Snapshot
from crashrate.runs.scenario import Scenario
from crashrate.traffic.model import TrafficModel
from crashrate.variables import FloatArray

SCENARIO = """
[variables.a]
unit = "m"
lower = 0
[variables.b]
[derived]
sum = "a + b"
[risk]
sum = "increasing"
[simulator]
kind = "python"
function = "small_vehicle:crashes"
[target]
relative_half_width = 0.3
max_calls = 60
"""
VEHICLE = """
def crashes(x):
    return x[:, 0] + x[:, 1] > 1.0
"""


def adaptive_method(problem: Problem) -> Generator[Query, FloatArray, Snapshot]:
    """Crude Monte Carlo whose next draws depend on every outcome so far."""
    snapshot, y_all, k = Snapshot(), np.empty(0), 0
    while len(y_all) < problem.max_calls:
        rng = problem.rng(k + 1000 * int(np.nansum(y_all)))
        x = problem.traffic.sample(problem.batch_size, rng)[: problem.max_calls - len(y_all)]
        y = yield Query(x, snapshot)
        y_all, k = np.concatenate([y_all, y]), k + 1
        p = float(np.nanmean(y_all))
        half = 2 * float(np.sqrt(max(p * (1 - p), 1e-3) / len(y_all)))
        snapshot = Snapshot(probability=p, interval=(p - half, p + half), phase="estimate")
        if half <= problem.target_at(len(y_all)) * p:
            return replace(snapshot, stop_reason=StopReason.TARGET_MET)
    return replace(snapshot, stop_reason=StopReason.BUDGET_ENDED)


@pytest.fixture(autouse=True)
def small_method(monkeypatch):
    monkeypatch.setitem(methods.METHODS, "small", adaptive_method)


@pytest.fixture
def scenario_file(tmp_path) -> Path:
    path = tmp_path / "small.toml"
    path.write_text(SCENARIO)
    (tmp_path / "small_vehicle.py").write_text(VEHICLE)
    return path


@pytest.fixture
def scenario(scenario_file) -> Scenario:
    return replace(Scenario.from_file(scenario_file), directory=None)


@pytest.fixture
def traffic() -> TrafficModel:
    return TrafficModel(
        [1.0], [[0.5, 0.0]], [np.eye(2)], [0.0, -np.inf], [np.inf, np.inf], ("a", "b")
    )


@pytest.fixture(autouse=True)
def vehicle(monkeypatch):
    """Every scenario of these tests is simulated in-process, unless it says otherwise."""
    simulate = CountingVehicle()
    monkeypatch.setattr(Scenario, "simulator", lambda _: simulate)
    return simulate


class CountingVehicle:
    """Counts its runs; fails in whatever way it is told to, at the call it is told to."""

    def __init__(self) -> None:
        self.n_runs = 0
        self.n_batches = 0
        self.trouble: dict[int, BaseException] = {}

    def __call__(self, x: FloatArray) -> object:
        self.n_batches += 1
        if self.n_batches in self.trouble:
            raise self.trouble[self.n_batches]
        self.n_runs += len(x)
        return x.sum(axis=1) > 1.0
