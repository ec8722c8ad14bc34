"""The demonstration: the whole way from events to a crash probability, without any file."""

from importlib.resources import files

import numpy as np

from crashrate import datasets
from crashrate.events import EventTable
from crashrate.runs.scenario import Scenario

N_COMPONENTS = 9  # as the 2017 study
SOURCE = "synthetic events, drawn from the published SPMD mixture"


def demo_scenario() -> Scenario:
    """The published configuration of the 2017 study, as it ships: `examples/huang2017.toml`."""
    resource = files("crashrate.runs").joinpath("scenarios", "huang2017.toml")
    return Scenario.from_text(resource.read_text(encoding="utf-8"), "huang2017")


def demo_events(seed: int) -> EventTable:
    """As many synthetic events as the study had real ones."""
    values = datasets.synthetic_spmd_events(seed=seed)
    names = datasets.spmd_mixture().names
    return EventTable(names, values, SOURCE, np.arange(len(values)))
