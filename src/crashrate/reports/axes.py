"""Axes: names, units and signs of what a run's figures and tables are drawn in."""

from collections.abc import Mapping
from dataclasses import dataclass

from crashrate.crash_set.order import RiskOrder
from crashrate.reports.units import derived_unit
from crashrate.runs.scenario import Scenario


@dataclass(frozen=True)
class Axis:
    """One quantity.

    Parameters
    ----------
    name, unit : str
    sign : float
        -1 where danger grows as the quantity falls: u = sign × quantity.
    """

    name: str
    unit: str
    sign: float = 1.0

    @property
    def label(self) -> str:
        """Name and unit, as on an axis."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    @property
    def riskier(self) -> str:
        """Which way is riskier, in words."""
        return "higher is riskier" if self.sign > 0 else "lower is riskier"


def units_of(scenario: Scenario) -> dict[str, str]:
    """Unit of every variable and derived quantity by name; empty where it cannot be told."""
    units = {v.name: v.unit for v in scenario.variables}
    for name, expression in scenario.derived.items():
        units[name] = derived_unit(expression.text, _stated(units))
    return units


def _stated(units: Mapping[str, str]) -> dict[str, str]:
    # "1" says dimensionless; "" says nothing, and so does what is computed from it
    return {name: unit for name, unit in units.items() if unit}


def variable_axes(scenario: Scenario) -> tuple[Axis, ...]:
    """The traffic model's variables."""
    return tuple(Axis(v.name, v.unit) for v in scenario.variables)


def risk_axes(scenario: Scenario, order: RiskOrder) -> tuple[Axis, ...]:
    """The risk coordinates, in physical units."""
    units = units_of(scenario)
    return tuple(Axis(c.name, units.get(c.name, ""), c.direction.sign) for c in order.coordinates)
