"""The record of a run: what its folder holds, read for reports and status."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from crashrate.errors import StoreError
from crashrate.runs.result import RESULT, read_result
from crashrate.runs.scenario import Scenario
from crashrate.runs.store import Batch, RunStore
from crashrate.traffic.model import TrafficModel
from crashrate.variables import FloatArray, frozen


@dataclass(frozen=True)
class RunRecord:
    """What a run folder holds.

    Parameters
    ----------
    directory : Path
    scenario : Scenario
    traffic : TrafficModel
    x : array (n, d)
        Situations simulated, in the order of the campaign and the traffic model's variables.
    outcomes : array (n,)
        1 crash, 0 safe, NaN failed.
    result : dict
        As `result.json` says.
    synthetic : bool
        Whether the traffic model was fitted to drawn events instead of recorded ones.
    consequences : array (n, K)
        Of each run, NaN where it failed.
    """

    directory: Path
    scenario: Scenario
    traffic: TrafficModel
    x: FloatArray
    outcomes: FloatArray
    result: dict[str, Any]
    synthetic: bool
    consequences: FloatArray = field(default_factory=lambda: np.empty((0, 0)))


def load_run(directory: str | Path) -> RunRecord:
    """The record of the run in `directory`.

    Raises
    ------
    StoreError
        If there is no run, it has no result yet, or its files are damaged.
    """
    directory = Path(directory)
    with RunStore.open(directory) as store:
        config = _require(directory, store.config(), ("scenario", "scenario_name", "traffic"))
        scenario = Scenario.from_text(config["scenario"], config["scenario_name"])
        names = scenario.outcome.consequences
        batches = store.batches(len(scenario.variables), len(names))
    result = read_result(directory)
    x, table = _rows(batches, len(scenario.variables), len(names), directory, result)
    return RunRecord(
        directory=directory,
        scenario=scenario,
        traffic=TrafficModel.from_json(config["traffic"]),
        x=x,
        outcomes=frozen(table[:, 0]),
        consequences=frozen(table[:, 1:]),
        result=result,
        synthetic=bool(result["synthetic"]),
    )


def _require(directory: Path, config: dict[str, str], keys: tuple[str, ...]) -> dict[str, str]:
    missing = [key for key in keys if key not in config]
    if missing:
        raise StoreError(
            f"{directory}: damaged: expected {', '.join(missing)} in the configuration, found "
            "none; restore the folder from a copy."
        )
    return config


def _rows(
    batches: list[Batch], d: int, n_z: int, directory: Path, result: dict[str, Any]
) -> tuple[FloatArray, FloatArray]:
    x = np.concatenate([np.empty((0, d)), *(batch.x for batch in batches)])
    tables = (batch.outcomes.reshape(-1, 1 + n_z) for batch in batches)
    table = np.concatenate([np.empty((0, 1 + n_z)), *tables])
    n = int(result["n_calls"])
    if n > len(x):
        raise StoreError(
            f"{directory}: expected the {n} simulator runs of {RESULT}, found {len(x)} in the "
            "store; write the result again with 'crashrate run' and the same arguments."
        )
    # a killed run may have stored a batch more than its last result counts
    return frozen(x[:n]), table[:n]
