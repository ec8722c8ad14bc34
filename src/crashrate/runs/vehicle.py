"""The vehicle under test that a scenario names, as a function of situations."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from crashrate.errors import InvalidInputError, ScenarioError
from crashrate.outcomes import Told
from crashrate.simulators import AccAeb, AccAebSimulator, PythonFunction
from crashrate.variables import FloatArray

if TYPE_CHECKING:
    from crashrate.runs.scenario import Scenario

Simulate = Callable[[FloatArray], Told]


def simulator_of(scenario: "Scenario") -> Simulate:
    """The simulator of `scenario`: rows (n, d) of its variables to n outcomes.

    Raises
    ------
    ScenarioError
        If it needs quantities that the scenario does not give, or there is no such function.
    SimulationError
        If the module of the function fails when it is imported.
    """
    try:
        return _acc_aeb(scenario) if scenario.simulator_choice.kind == "acc-aeb" else _own(scenario)
    except InvalidInputError as error:
        raise ScenarioError(f"{_file(scenario)}, [simulator]: {error}") from error


def source_hash_of(simulate: Simulate) -> str:
    """What tells an edited simulator from the one before; empty for the plants of this package."""
    return simulate.source_hash() if isinstance(simulate, PythonFunction) else ""


def _file(scenario: "Scenario") -> str:
    name = f"{scenario.name}.toml"
    return name if scenario.directory is None else str(scenario.directory / name)


def _acc_aeb(scenario: "Scenario") -> AccAebSimulator:
    if scenario.outcome.consequences:
        raise InvalidInputError(
            "kind 'acc-aeb' tells crashes alone, and [outcome] declares consequences "
            f"({', '.join(scenario.outcome.consequences)}); leave them out, or give kind 'python' "
            "with a function that calls crashrate.simulators.AccAeb and returns what it wants of "
            "impact_speed."
        )
    choice = scenario.simulator_choice
    plant = (
        AccAeb.published()
        if choice.published
        else AccAeb(choice.closing_speed_cap, choice.ego_speed_cap)
    )
    return AccAebSimulator.for_variables(plant, scenario.names, scenario.derived)


def _own(scenario: "Scenario") -> PythonFunction:
    folder = None if scenario.directory is None else str(scenario.directory)
    consequences = scenario.outcome.consequences
    function = PythonFunction(scenario.simulator_choice.function, folder, consequences)
    function.load()  # fail before anything is stored
    return function
