"""What is compared in the tails, by the scenario's own words."""

from pathlib import Path

import numpy as np
import pytest

from crashrate.runs.quantities import FAR, quantities
from crashrate.runs.scenario import Scenario
from crashrate.simulators import AccAeb, AccAebSimulator

EXAMPLES = Path(__file__).parents[2] / "examples"


def by_name(scenario, simulate=None):
    return {q.name: q for q in quantities(scenario, simulate or (lambda x: x))}


def test_cut_in_has_the_measures_of_the_field():
    scenario = Scenario.from_file(EXAMPLES / "cut_in.toml")
    plant = AccAebSimulator.for_variables(AccAeb(), scenario.names, scenario.derived)
    found = by_name(scenario, plant)
    assert list(found) == ["v_lead", "closing_speed", "range", "TTC", "DRAC", "minimum gap"]
    x = np.array([[20.0, 0.05, 4.0], [20.0, 0.05, 0.0]])
    assert found["TTC"].of(x).tolist() == pytest.approx([5.0, FAR])
    assert found["DRAC"].of(x).tolist() == pytest.approx([0.4, 0.0])
    assert found["range"].of(x).tolist() == pytest.approx([20.0, 20.0])
    assert found["minimum gap"].of(x)[0] < 20.0
    assert [q.sign for q in found.values()] == [-1, 1, -1, -1, 1, -1]


def test_only_what_has_a_direction(scenario):
    assert list(by_name(scenario)) == ["sum"]
    text = scenario.text.replace('[risk]\nsum = "increasing"', "")
    assert by_name(Scenario.from_text(text, "small")) == {}
