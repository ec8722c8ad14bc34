"""What is compared in the tails of recordings and model: variables, TTC, DRAC, the gap."""

from collections.abc import Callable

import numpy as np

from crashrate.expressions import Expression
from crashrate.recordings.near_misses import Quantity
from crashrate.runs.scenario import Scenario
from crashrate.runs.vehicle import Simulate
from crashrate.simulators import AccAebSimulator
from crashrate.variables import Direction, FloatArray

FAR = 1e9  # s: a TTC of events that hardly close


def quantities(scenario: Scenario, simulate: Simulate) -> tuple[Quantity, ...]:
    """Of the risk order, TTC and DRAC where they can be computed, the gap where it is known."""
    risk = scenario.risk or {}
    found = [_declared(scenario, name, way) for name, way in risk.items()]
    if _has(scenario, "range") and _has(scenario, "closing_speed"):
        gap, closing = _column(scenario, "range"), _column(scenario, "closing_speed")
        found.append(Quantity("TTC", "s", _ttc(gap, closing), -1.0))
        found.append(Quantity("DRAC", "m/s²", _drac(gap, closing), 1.0))
    if isinstance(simulate, AccAebSimulator):  # runs that cost nothing
        found.append(Quantity("minimum gap", "m", _smallest_gap(simulate), -1.0))
    return tuple(found)


def _declared(scenario: Scenario, name: str, way: Direction) -> Quantity:
    unit = next((v.unit for v in scenario.variables if v.name == name), "")
    return Quantity(name, unit, _column(scenario, name), way.sign)


def _has(scenario: Scenario, name: str) -> bool:
    return name in scenario.names or name in scenario.derived


def _column(scenario: Scenario, name: str) -> Callable[[FloatArray], FloatArray]:
    return scenario.derived.get(name) or Expression(name, scenario.names)


Column = Callable[[FloatArray], FloatArray]


def _ttc(gap: Column, closing: Column) -> Column:
    """Time to collision R / c; far away where the two hardly close."""

    def ttc(x: FloatArray) -> FloatArray:
        r, c = gap(x), closing(x)
        return np.asarray(np.where(c > r / FAR, r / np.maximum(c, r / FAR), FAR))

    return ttc


def _drac(gap: Column, closing: Column) -> Column:
    """Deceleration rate to avoid a crash, c² / 2R."""
    return lambda x: np.asarray(np.maximum(closing(x), 0.0) ** 2 / (2 * gap(x)))


def _smallest_gap(simulate: AccAebSimulator) -> Column:
    return lambda x: simulate.run(x).min_range
