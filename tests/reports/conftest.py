import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from crashrate.estimation.alarms import StopReason
from crashrate.estimation.consequence import Consequence
from crashrate.estimation.estimate import Estimate, HistoryPoint
from crashrate.runs.record import RunRecord
from crashrate.runs.scenario import Scenario
from crashrate.traffic.model import TrafficModel

CUT_IN = """
[variables.v_lead]
unit = "m/s"
lower = 5
upper = 35
[variables.inv_range]
unit = "1/m"
lower = 0.0133
[variables.inv_ttc]
unit = "1/s"
lower = 0
[derived]
range = "1 / inv_range"
closing_speed = "inv_ttc / inv_range"
[risk]
v_lead = "decreasing"
closing_speed = "increasing"
range = "decreasing"
[simulator]
kind = "acc-aeb"
published = true
"""


def scenario_text(n_variables, risk):
    variables = "".join(f'[variables.x{k}]\nunit = "m"\n' for k in range(n_variables))
    order = "".join(f'{name} = "{direction}"\n' for name, direction in risk.items())
    section = f"[risk]\n{order}" if risk else ""
    return f'{variables}{section}[simulator]\nkind = "python"\nfunction = "vehicles:crash"\n'


def make_traffic(scenario, provenance=None):
    d = len(scenario.variables)
    if scenario.names[0] == "v_lead":
        mean, scale = np.array([15.0, 0.03, 0.05]), np.array([6.0, 0.03, 0.08])
    else:
        mean, scale = np.zeros(d), np.ones(d)
    return TrafficModel(
        weights=[0.7, 0.3],
        means=[mean, mean + 0.2 * scale],
        covariances=[np.diag(scale**2), 2 * np.diag(scale**2)],
        lower=scenario.lower,
        upper=scenario.upper,
        names=scenario.names,
        provenance=provenance or {},
    )


def make_estimate(n_calls=200, n_crashes=60, **changes):
    history = tuple(
        HistoryPoint(n, math.nan, 0.0, 1.0, "explore")
        if n < 60
        else HistoryPoint(n, 2e-6, 2e-6 - 3e-6 / n**0.5, 2e-6 + 3e-6 / n**0.5, "estimate")
        for n in range(20, n_calls + 1, 20)
    )
    values = dict(
        probability=1.976e-6,
        interval=(1.8e-6, 2.2e-6),
        confidence=0.95,
        standard_error=1e-7,
        bounds=(1.2e-6, 8.1e-6),
        n_calls=n_calls,
        n_crashes=n_crashes,
        n_failed=0,
        n_eff=131.2,
        largest_weight_share=0.043,
        log_efficiency=1.87,
        alarms=(),
        stop_reason=StopReason.TARGET_MET,
        method="sequential",
        seed=17,
        history=history,
    )
    return Estimate(**(values | changes))


def make_record(text=CUT_IN, *, estimate=None, danger=None, provenance=None, n=200, **changes):
    """A run on real objects: `danger` maps rows to what is positive for a crash."""
    scenario = Scenario.from_text(text, "cut-in")
    traffic = make_traffic(scenario, provenance)
    spread = dataclasses.replace(traffic, covariances=6 * traffic.covariances)
    x = spread.sample(n, 3)
    crash = (danger or default_danger)(x) > 0
    estimate = estimate or make_estimate(n, int(crash.sum()))
    synthetic = changes.pop("synthetic", False)
    result = estimate.to_dict() | {
        "sentence": estimate.sentence(scenario.outcome.event, scenario.outcome.per),
        "versions": {"crashrate": "0.1.0", "numpy": "2.0"},
        "target": {"relative_half_width": 0.1, "max_calls": 2000},
        "synthetic": synthetic,
    }
    record = RunRecord(
        directory=Path("runs/x"),
        scenario=scenario,
        traffic=traffic,
        x=x,
        outcomes=crash.astype(float),
        result=result,
        synthetic=synthetic,
    )
    return dataclasses.replace(record, **changes)


def default_danger(x):
    """Monotone in (v_lead down, closing speed up, range down)."""
    return x[:, 2] / x[:, 1] - 0.15 * x[:, 0] - 0.1 / x[:, 1] + 2


@pytest.fixture
def consequences():
    injury = Consequence(
        name="injury",
        mean=9.88e-7,
        interval=(8.9e-7, 1.1e-6),
        standard_error=5e-8,
        n_eff=390.0,
        n_carrying=60,
        largest_weight_share=0.02,
        aimed=True,
    )
    severe = dataclasses.replace(
        injury, name="severe", interval=(0.0, 3e-7), n_eff=0.5, n_carrying=1, aimed=False
    )
    return injury, severe


@pytest.fixture
def build():
    return make_record


@pytest.fixture
def estimate():
    return make_estimate


@pytest.fixture
def problem():
    """Text of a scenario with n variables x0, x1, … and this risk order."""
    return scenario_text
