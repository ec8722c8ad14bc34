"""After a campaign: replay the recordings, and check the traffic model's tail against them."""

import warnings
from collections.abc import Callable
from typing import Protocol

import numpy as np

from crashrate.crash_set.order import RiskOrder
from crashrate.errors import InvalidInputError, ScenarioError, SimulationError
from crashrate.events import EventTable
from crashrate.recordings.check import Check, check
from crashrate.recordings.comparison import Comparison
from crashrate.recordings.replay import Replay, replayed, to_simulate
from crashrate.recordings.severity import Severity
from crashrate.runs.quantities import quantities
from crashrate.runs.scenario import Scenario
from crashrate.runs.store import Batch, RunStore, blob
from crashrate.runs.vehicle import Simulate
from crashrate.variables import FloatArray

REPLAY_CALLS = 50
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
    _require_nothing_at_1(scenario, severity, events)
    calm = _coordinates(scenario, events.values, 1.0)
    for level in severity.levels[1:]:  # at the first, 1, nothing changes
        worse = severity(events.values, level)
        bad = np.argwhere(~np.isfinite(worse))
        if len(bad):
            i, j = (int(v) for v in bad[0])
            raise _refused(
                scenario,
                f"expected finite numbers, got {worse[i, j]} for "
                f"{events.names[j]} of event {int(events.rows[i]) + 1} at severity {level:g}; "
                "change the expression.",
            )
        _require_worse(scenario, events, calm, _coordinates(scenario, worse, level), level)


def _refused(scenario: Scenario, why: str) -> ScenarioError:
    return ScenarioError(f"{scenario.name}.toml, [severity]: {why}")


def _require_nothing_at_1(scenario: Scenario, severity: Severity, events: EventTable) -> None:
    at_1 = severity(events.values, 1.0)
    same = np.isclose(at_1, events.values, rtol=1e-9)
    if not same.all():
        i, j = (int(v) for v in np.argwhere(~same)[0])
        raise _refused(
            scenario,
            f"expected an event as it was recorded at severity "
            f"1, got {at_1[i, j]:g} in place of "
            f"{events.values[i, j]:g} for {events.names[j]} of event {int(events.rows[i]) + 1}; "
            f"write it so that 1 changes nothing, such as {events.names[j]} * severity.",
        )


def _coordinates(scenario: Scenario, x: FloatArray, level: float) -> FloatArray | None:
    """Risk coordinates (n, m) of events made worse; None where no order is declared."""
    risk = scenario.risk_mapping()
    if risk is None:
        return None
    try:
        return RiskOrder.from_mapping(risk, scenario.names)(x)
    except InvalidInputError as error:
        raise _refused(scenario, f"at severity {level:g}: {error}") from error


def _require_worse(
    scenario: Scenario,
    events: EventTable,
    calm: FloatArray | None,
    worse: FloatArray | None,
    level: float,
) -> None:
    if calm is None or worse is None:
        return
    safer = np.argwhere(worse < calm - 1e-9 * np.abs(calm))
    if len(safer):
        i, k = (int(v) for v in safer[0])
        raise _refused(
            scenario,
            f"at severity {level:g} event "
            f"{int(events.rows[i]) + 1} is less dangerous in {[*(scenario.risk or ())][k]!r} than "
            "as it was recorded, by the order of [risk]; a severity makes events worse.",
        )


def check_recordings(sitting: Sitting, c: Comparison, *, max_calls: int, say: Say) -> Check:
    """Replay the events, up to `max_calls` of them simulated and stored, and check the tail."""
    replay = _replay(sitting, c, max_calls, say)
    return check(c, quantities(sitting.scenario, sitting.simulate), replay, say)


def _replay(sitting: Sitting, c: Comparison, max_calls: int, say: Say) -> Replay:
    """Simulate what is in doubt; equal events share a simulator run and its outcome."""
    x = c.events.values
    seen = c.belief.see(c.z)
    _, first, same = np.unique(x, axis=0, return_index=True, return_inverse=True)
    chosen = to_simulate(seen.h[first], seen.surrogate_h[first], max_calls, ordered=c.ordered)
    known = _outcomes(sitting, x[first[chosen]], say)
    outcomes, failed = np.full(len(first), np.nan), np.zeros(len(first), dtype=bool)
    for i in chosen:
        if (outcome := known.get(blob(x[first[i]]))) is not None:
            outcomes[i], failed[i] = outcome, np.isnan(outcome)
    return replayed(
        seen.h,
        outcomes[same.ravel()],
        c.events.rows,
        failed=failed[same.ravel()],
        n_runs=sum(blob(x[first[i]]) in known for i in chosen),
        confidence=c.confidence,
        ordered=c.ordered,
    )


def _outcomes(sitting: Sitting, x: FloatArray, say: Say) -> dict[bytes, float]:
    """Outcomes by situation, those of x (n, d) among them unless the simulator raises.

    The answer of the campaign stands whatever happens here. A failed simulation is not stored: the
    next call tries it again, as no campaign depends on it.
    """
    known = sitting.store.replays()
    try:
        for i, row in enumerate(x):
            say(f"replaying the recordings: {i} of {len(x)}")
            if blob(row) in known:
                continue
            known[blob(row)] = outcome = float(sitting.simulated(row[None])[0])
            if not np.isnan(outcome):
                sitting.store.add_replays(Batch(row[None], np.array([outcome])))
    except SimulationError as error:
        warnings.warn(
            f"replaying the recordings stopped: {error} The answer stands; events that were not "
            "simulated are in doubt. The same command tries them again.",
            stacklevel=2,
        )
    return known
