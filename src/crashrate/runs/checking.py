"""After a campaign: replay the recordings, and check the traffic model's tail against them."""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from crashrate.crash_set.order import RiskOrder
from crashrate.errors import InvalidInputError, ScenarioError
from crashrate.events import EventTable
from crashrate.recordings.check import Check, check
from crashrate.recordings.comparison import Comparison
from crashrate.recordings.replay import Replay, replayed, to_simulate
from crashrate.runs.quantities import quantities
from crashrate.runs.scenario import Scenario
from crashrate.runs.store import Batch, RunStore, blob
from crashrate.runs.vehicle import Simulate
from crashrate.variables import FloatArray

REPLAY_CALLS = 50
BATCH = 10
Say = Callable[[str], None]


class Sitting(Protocol):
    """What a check needs of a run."""

    @property
    def scenario(self) -> Scenario: ...  # noqa: D102
    @property
    def store(self) -> RunStore: ...  # noqa: D102
    @property
    def simulate(self) -> Simulate: ...  # noqa: D102

    def simulated(self, x: FloatArray) -> FloatArray:
        """Outcomes (n,) of situations x (n, d)."""


def require_severity(scenario: Scenario, events: EventTable) -> None:
    """Refuse a severity that makes an event no situation: before a simulator run is spent on it.

    Raises
    ------
    ScenarioError
        Naming the event, the factor and the variable.
    """
    severity = scenario.severity
    if severity is None:
        return
    for level in severity.levels:
        worse = severity(events.values, level)
        bad = np.argwhere(~np.isfinite(worse))
        if len(bad):
            i, j = (int(v) for v in bad[0])
            raise ScenarioError(
                f"{scenario.name}.toml, [severity]: expected finite numbers, got {worse[i, j]} for "
                f"{events.names[j]} of event {int(events.rows[i]) + 1} at severity {level:g}; "
                "change the expression."
            )
        _require_coordinates(scenario, worse, level)


def _require_coordinates(scenario: Scenario, worse: FloatArray, level: float) -> None:
    risk = scenario.risk_mapping()
    try:
        if risk is not None:
            RiskOrder.from_mapping(risk, scenario.names)(worse)
    except InvalidInputError as error:
        raise ScenarioError(
            f"{scenario.name}.toml, [severity]: at severity {level:g}: {error}"
        ) from error


def check_recordings(
    sitting: Sitting, c: Comparison, *, max_calls: int, confidence: float, say: Say
) -> Check:
    """Replay the events, up to `max_calls` of them simulated and stored, and check the tail."""
    say("replaying the recordings")
    replay = _replay(sitting, c, max_calls, confidence)
    return check(c, quantities(sitting.scenario, sitting.simulate), replay, say)


def _replay(sitting: Sitting, c: Comparison, max_calls: int, confidence: float) -> Replay:
    h = c.belief(c.z)
    chosen = to_simulate(h, max_calls)
    outcomes = _outcomes(sitting, c.events.values[chosen])
    return replayed(h, chosen, outcomes, c.events.rows, confidence)


def _outcomes(sitting: Sitting, x: FloatArray) -> FloatArray:
    """Outcomes (n,) of recorded events, each simulated once however often it was recorded."""
    known = sitting.store.replays()
    new = np.array([row for row in np.unique(x, axis=0) if blob(row) not in known])
    for start in range(0, len(new), BATCH):
        rows = new[start : start + BATCH]
        batch = Batch(rows, sitting.simulated(rows))
        sitting.store.add_replays(batch)
        known |= {blob(row): y for row, y in zip(rows, batch.outcomes, strict=True)}
    return np.array([known[blob(row)] for row in x])
