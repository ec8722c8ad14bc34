"""The scenario: what is what, as a TOML file says it and as a frozen value."""

import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from crashrate.errors import ScenarioError
from crashrate.expressions import Expression
from crashrate.recordings.severity import Severity
from crashrate.runs import sections
from crashrate.runs.keys import Table
from crashrate.variables import Direction, Variable

if TYPE_CHECKING:
    from crashrate.runs.vehicle import Simulate

SECTIONS = (
    "variables", "derived", "risk", "simulator", "target", "events", "severity", "outcome",
)  # fmt: skip


@dataclass(frozen=True)
class Scenario:
    """What a scenario file says.

    Parameters
    ----------
    name : str
        The file's name without its ending.
    variables : tuple of Variable
        The columns of the traffic model, in order.
    derived : mapping
        Derived quantity's name to its `Expression` on the variables.
    risk : mapping or None
        Variable's or derived quantity's name to the direction in which danger grows; None claims
        nothing.
    simulator_choice : sections.SimulatorChoice
    target : sections.Target
    events : sections.EventColumns
    severity : Severity or None
        How a recorded event is made worse, to compare the tails of recordings and model.
    outcome : sections.Outcome
    text : str
        The file, as it was read.
    directory : Path or None
        Where the file lies: Python simulators are looked for there first.
    """

    name: str
    variables: tuple[Variable, ...]
    derived: Mapping[str, Expression]
    risk: Mapping[str, Direction] | None
    simulator_choice: sections.SimulatorChoice
    target: sections.Target
    events: sections.EventColumns
    severity: Severity | None
    outcome: sections.Outcome
    text: str = field(repr=False)
    directory: Path | None = field(default=None, repr=False)

    @classmethod
    def from_file(cls, path: str | Path) -> "Scenario":
        """The scenario that the TOML file at `path` describes.

        Raises
        ------
        ScenarioError
            If the file is missing, is not TOML, or says something unknown or of another type: the
            message names file and section, and the nearest known key.
        """
        path = Path(path)
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            why = (error.strerror if isinstance(error, OSError) else None) or error
            raise ScenarioError(
                f"{path}: expected a scenario file (TOML, UTF-8), got: {why}."
            ) from error
        return cls.from_text(text, name=path.stem, file=str(path), directory=path.parent)

    @classmethod
    def from_text(
        cls, text: str, name: str = "scenario", file: str | None = None, directory: Any = None
    ) -> "Scenario":
        """The scenario that a TOML text describes; `file` is its name in messages.

        Raises
        ------
        ScenarioError
            As `from_file`.
        """
        file = file or f"{name}.toml"
        try:
            root = Table(tomllib.loads(text), file)
        except tomllib.TOMLDecodeError as error:
            raise ScenarioError(f"{file}: expected TOML, got: {error}.") from error
        root.only(SECTIONS, "section")
        variables = sections.read_variables(root.table("variables"))
        names = tuple(v.name for v in variables)
        derived = sections.read_derived(root.table("derived"), names)
        events = sections.read_events(root.table("events"), names)
        target = sections.read_target(root.table("target"))
        outcome = sections.read_outcome(root.table("outcome"))
        sections.require_aim(root, target, outcome)
        return cls(
            name=name,
            variables=variables,
            derived=MappingProxyType(derived),
            risk=sections.read_risk(root, (*names, *derived)),
            simulator_choice=sections.read_simulator(root.table("simulator")),
            target=target,
            events=events,
            severity=sections.read_severity(root, names, events.closing),
            outcome=outcome,
            text=text,
            directory=directory,
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the variables, in order."""
        return tuple(v.name for v in self.variables)

    @property
    def lower(self) -> tuple[float, ...]:
        """Lower bounds of the variables."""
        return tuple(v.lower for v in self.variables)

    @property
    def upper(self) -> tuple[float, ...]:
        """Upper bounds of the variables."""
        return tuple(v.upper for v in self.variables)

    def to_text(self) -> str:
        """The text of the file, as it was read."""
        return self.text

    def risk_mapping(self) -> dict[str, Any] | None:
        """The declared order, as `Campaign` takes it: derived quantities with their expression."""
        if self.risk is None:
            return None
        return {
            name: (self.derived[name], direction.value) if name in self.derived else direction.value
            for name, direction in self.risk.items()
        }

    def simulator(self) -> "Simulate":
        """The simulator: rows (n, d) of the variables to n outcomes, NaN where it failed.

        Raises
        ------
        ScenarioError
            If it needs quantities that the scenario does not give, or cannot be imported.
        """
        from crashrate.runs.vehicle import simulator_of

        return simulator_of(self)

    @property
    def identity(self) -> dict[str, Any]:
        """What a run depends on, section by section; target, events and words are not in it."""
        choice = self.simulator_choice
        return {
            "[variables]": [[v.name, repr(v.lower), repr(v.upper)] for v in self.variables],
            "[derived]": {name: e.text for name, e in self.derived.items()},
            "[risk]": None if self.risk is None else [[n, d.value] for n, d in self.risk.items()],
            "[simulator]": {k: v for k, v in vars(choice).items() if v not in (None, "", False)},
            "[target] confidence": self.target.confidence,
            "[outcome] consequences": list(self.outcome.consequences),
        }

    @property
    def fingerprint(self) -> str:
        """`identity` in one text: equal for equal runs, whatever comments and spaces say."""
        return json.dumps(self.identity, sort_keys=True)
