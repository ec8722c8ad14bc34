"""The runner: a campaign, a simulator and a store, where the three meet.

A run is a function of (configuration, seed, outcomes), so resume is replay: the stored outcomes
are told to a new campaign, which must ask for the stored situations again, bit for bit.
"""

import json
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from crashrate.errors import SimulationError, StoreError
from crashrate.estimation.campaign import Campaign
from crashrate.estimation.estimate import Estimate
from crashrate.estimation.strategy import Problem
from crashrate.events import EventTable
from crashrate.recordings.check import Check
from crashrate.recordings.comparison import Comparison
from crashrate.runs.checking import REPLAY_CALLS, check_recordings, require_severity
from crashrate.runs.configuration import (
    BUDGETS,
    SOURCE,
    TARGETS,
    VOUCHED,
    Number,
    configuration,
    require_budget,
    require_same_run,
    require_same_source,
    require_same_variables,
    target_text,
    targets,
    versions,
    vouched,
)
from crashrate.runs.looked_at import (
    NO_EVENTS,
    doubted,
    entry,
    found_before,
    unchecked_by,
    why_unsettled,
)
from crashrate.runs.notes import notes
from crashrate.runs.only_writer import is_being_written, only_writer
from crashrate.runs.result import read_result, result_dict, write_result
from crashrate.runs.scenario import Scenario
from crashrate.runs.store import Batch, RunStore
from crashrate.runs.vehicle import Simulate, source_hash_of
from crashrate.simulators import check_outcomes
from crashrate.traffic.model import TrafficModel
from crashrate.variables import FloatArray

Value = TypeVar("Value", int, float, str)

SECONDS_BETWEEN_RESULTS = 1.0  # so that status can follow a run, and writing costs nothing


def run(
    scenario: Scenario,
    traffic: TrafficModel,
    out: str | Path,
    *,
    seed: int = 0,
    method: str | None = None,
    relative_half_width: float | None = None,
    max_calls: int | None = None,
    goal: str | None = None,
    aim: str | None = None,
    batch_size: int = Problem.batch_size,
    same_vehicle: bool = False,
    events: EventTable | None = None,
    without_events: str = NO_EVENTS,
    replay_calls: int = REPLAY_CALLS,
    on_progress: Callable[[Campaign], None] | None = None,
    say: Callable[[str], None] | None = None,
) -> Estimate:
    """Run a scenario in traffic, in a folder that a later call continues.

    An interrupted run is resumed by the same call. Target and budget may change from one call to
    the next, the budget not below what is stored: the campaign goes on from there.

    Parameters
    ----------
    scenario : Scenario
    traffic : TrafficModel
        On the scenario's variables and bounds.
    out : str or Path
        The run folder, made where it is missing.
    seed, batch_size
        As of `Campaign`.
    method, relative_half_width, max_calls : optional
        Method, target and budget; the scenario's where not given.
    goal : optional
        As of `Campaign`; the scenario's where not given. Another one is another run.
    aim : optional
        Likewise: the consequence that the target is for; the event's name for the event itself.
    same_vehicle : bool
        Whether the stored outcomes count although the simulator's source was edited since.
    events : EventTable, optional
        That the traffic model was fitted to: replayed at the end, and compared with the model.
    without_events : str
        Why there are none: kept with the result, so that a reader knows what was not checked.
    replay_calls : int
        Most simulator runs that the replay may take, beside the campaign's budget.
    on_progress : callable, optional
        Called with the campaign after every batch.
    say : callable, optional
        Told what is done after the campaign.

    Returns
    -------
    Estimate
        Also in `result.json`, which is whole at every moment.

    Raises
    ------
    InvalidInputError
        If an argument is not as described, or the traffic model has other variables.
    StoreError
        If the folder holds the run of another configuration or of a simulator that was edited
        since, or more runs than `max_calls`, or is damaged, or another process runs in it.
    SimulationError
        If the simulator failed; everything before is stored, and the same call resumes.
    """
    directory, target = Path(out), scenario.target
    require_same_variables(scenario, traffic)
    if events is not None:
        require_severity(scenario, events)
    with only_writer(directory):
        half_width = _given(relative_half_width, target.relative_half_width)
        aims = _targets(directory, float(half_width), TARGETS)
        budget = _given(max_calls, target.max_calls)
        budgets = _targets(directory, budget, BUDGETS)
        campaign = Campaign(
            traffic,
            risk=scenario.risk_mapping(),
            seed=seed,
            relative_half_width=half_width,
            max_calls=budget,
            confidence=target.confidence,
            method=_given(method, target.method),
            goal=goal or target.goal,
            batch_size=batch_size,
            consequences=scenario.outcome.consequences,
            aim=target.aim if aim is None else _aimed(aim, scenario),
            earlier_targets=[(t, n) for (t, _), (_, n) in pairwise(aims)],
            earlier_budgets=[(b, n) for (b, _), (_, n) in pairwise(budgets)],
        )
        simulate = scenario.simulator()
        config = configuration(scenario, traffic, campaign, source_hash_of(simulate))
        with _store(directory, config, campaign.problem, same_vehicle=same_vehicle) as store:
            store.set_config(TARGETS, json.dumps(aims))
            store.set_config(BUDGETS, json.dumps(budgets))
            sitting = _Sitting(
                directory,
                scenario,
                traffic,
                campaign,
                simulate,
                store,
                on_progress or _ignore,
                without_events if events is None else unchecked_by(campaign.method),
            )
            estimate = _go_on(sitting, _replay(sitting))
            belief = campaign.snapshot.belief
            if events is None or sitting.unchecked:
                return estimate
            if belief is None:
                return _write(sitting, estimate, unchecked=why_unsettled(estimate))
            comparison = Comparison(
                events, traffic, belief, scenario.severity, seed, target.confidence
            )
            return _checked(sitting, estimate, comparison, replay_calls, say or _say_nothing)


def status(directory: str | Path) -> dict[str, Any]:
    """What `result.json` of the run in `directory` says, and how far the run is by now.

    `running` is whether a process is at it, `n_stored` how many outcomes it has stored, and
    `seconds_since_stored` how long ago it last did: a simulator that hangs is told by that.

    Raises
    ------
    StoreError
        If there is no run, it has no result yet, or it is damaged.
    """
    with RunStore.open(Path(directory)) as store:
        stored = {"n_stored": store.n_runs(), "seconds_since_stored": store.seconds_since_stored()}
    running = {"running": is_being_written(Path(directory))}
    return read_result(Path(directory)) | running | stored


def n_stored(directory: str | Path) -> int:
    """Number of simulator runs that `directory` holds: 0 where there is no run.

    Raises
    ------
    StoreError
        If the run is damaged.
    """
    if not RunStore.exists(Path(directory)):
        return 0
    with RunStore.open(Path(directory)) as store:
        return store.n_runs()


def _aimed(aim: str, scenario: Scenario) -> str | None:
    """The consequence that is aimed at; None where the event itself is named."""
    return None if aim == scenario.outcome.event else aim


def _targets(directory: Path, target: Number, key: str) -> list[tuple[Number, int]]:
    """What the run in `directory` aimed at so far, or its budgets, `target` last."""
    if not RunStore.exists(directory):
        return targets({}, 0, target, key)
    with RunStore.open(directory) as store:
        return targets(store.config(), store.n_runs(), target, key)


def _store(
    directory: Path, config: dict[str, str], problem: Problem, *, same_vehicle: bool
) -> RunStore:
    if not RunStore.exists(directory):
        return RunStore.create(directory, config)
    store = RunStore.open(directory)
    try:
        stored = store.config()
        require_same_run(directory, stored, config)
        n_runs = store.n_runs()
        if n_runs and not same_vehicle:
            require_same_source(directory, stored, config)
        require_budget(directory, n_runs, stored.get("target"), problem)
        if n_runs and stored.get(SOURCE) and stored[SOURCE] != config[SOURCE]:
            store.set_config(VOUCHED, vouched(stored, n_runs))
        # it failed on its first situation, say, and was mended; or the user vouches for it
        store.set_config(SOURCE, config[SOURCE])
    except StoreError:
        store.close()
        raise
    return store


def _given(value: Value | None, default: Value) -> Value:
    return default if value is None else value


@dataclass(frozen=True)
class _Sitting:
    """The pieces that meet in one call of `run`."""

    directory: Path
    scenario: Scenario
    traffic: TrafficModel
    campaign: Campaign
    simulate: Simulate
    store: RunStore
    on_progress: Callable[[Campaign], None]
    unchecked: str  # why the recordings will not be looked at; empty where they will

    def simulated(self, x: FloatArray) -> FloatArray:
        """Outcomes (n,) of `x` (n, d), checked."""
        table = self.told(x)
        return table[:, 0] if table.ndim == 2 else table

    def told(self, x: FloatArray) -> FloatArray:
        """Outcomes (n,) of `x` (n, d), checked before anything is stored or told.

        With K consequences a table (n, 1 + K).
        """
        names = self.campaign.problem.consequences
        try:
            return check_outcomes(self.simulate(x), len(x), consequences=names)
        except SimulationError as error:
            n = self.campaign.n_calls
            raise SimulationError(
                f"{error} The {n} simulator runs before are stored in {self.directory}: the same "
                "command goes on after them; with --same-vehicle also once the simulator is mended."
                if n
                else str(error)
            ) from error

    def tell(self, outcomes: FloatArray) -> None:
        """Tell the campaign, and whoever watches."""
        self.campaign.tell(outcomes)
        self.on_progress(self.campaign)


def _checked(
    sitting: _Sitting,
    estimate: Estimate,
    comparison: Comparison,
    max_calls: int,
    say: Callable[[str], None],
) -> Estimate:
    """The estimate with the alarms that the recordings raise; the result written again."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1):
        found = check_recordings(sitting, comparison, max_calls=max_calls, say=say)
    for part, why in found.failed.items():
        warnings.warn(f"checking the recordings, {part}: {why}", stacklevel=2)
    return _write(sitting, estimate, found)


def _say_nothing(_: str) -> None:
    """Nobody listens."""


def _ignore(_: Campaign) -> None:
    """Nobody watches."""


def _replay(sitting: _Sitting) -> int:
    """Tell the campaign what is stored; the number of batches in the store."""
    campaign = sitting.campaign
    problem = campaign.problem
    batches = sitting.store.batches(problem.traffic.n_variables, len(problem.consequences))
    for k, batch in enumerate(batches):
        if campaign.done:  # with a smaller budget, or a wider target, than was stored
            break
        sitting.tell(_recalled(sitting, k, batch, campaign.ask()))
    sitting.store.set_config("target", target_text(problem))
    return len(batches)


def _recalled(sitting: _Sitting, k: int, batch: Batch, x: FloatArray) -> FloatArray:
    """Outcomes of `x` from the stored `batch`; one cut short by its budget is completed."""
    n = min(len(x), len(batch.x))
    if x[:n].tobytes() != batch.x[:n].tobytes():
        raise StoreError(_parted(sitting, k))
    if n == len(x):
        return batch.outcomes[:n]
    outcomes = np.concatenate([batch.outcomes, sitting.told(x[n:])])
    sitting.store.extend(k, Batch(x, outcomes))
    return outcomes


def _parted(sitting: _Sitting, k: int) -> str:
    """Why the campaign may have parted from its record at batch `k`, and what to do."""
    config, campaign = sitting.store.config(), sitting.campaign
    stored, asked = config.get("target"), target_text(campaign.problem)
    if stored != asked:
        return (
            f"{sitting.directory}: holds a run that aims at {stored}; with the method "
            f"{campaign.method!r} it cannot go on to {asked}. Ask for what it aims at, or choose "
            "another --out."
        )
    return (
        f"{sitting.directory}: expected the campaign to ask for the situations of batch {k} again, "
        f"bit for bit; it asks for others. The run was begun with {config.get('versions')}, these "
        f"are {json.dumps(versions())}: continue with the versions that began it, or choose "
        "another --out."
    )


def _go_on(sitting: _Sitting, k: int) -> Estimate:
    """Simulate from batch `k` on, storing every batch before the next is asked for."""
    campaign = sitting.campaign
    # of the last whole step: an interrupted one leaves the campaign between two states
    estimate, written = campaign.estimate(), time.monotonic()
    _write(sitting, estimate)  # status has something to show while the first batch is simulated
    try:
        while not campaign.done:
            x = campaign.ask()
            outcomes = sitting.told(x)
            sitting.store.append(k, Batch(x, outcomes))
            sitting.tell(outcomes)
            estimate, k = campaign.estimate(), k + 1
            if time.monotonic() - written > SECONDS_BETWEEN_RESULTS:
                _write(sitting, estimate)
                written = time.monotonic()
    finally:
        told = _write(sitting, estimate)
    return told


def _write(
    sitting: _Sitting, estimate: Estimate, found: Check | None = None, unchecked: str = ""
) -> Estimate:
    """Write the result; the estimate with the alarms that the recordings raise."""
    found = found or found_before(sitting.directory, estimate)
    estimate = doubted(estimate, sitting.traffic, found)
    problem, n_members = sitting.campaign.problem, len(sitting.traffic.members)
    result = result_dict(estimate, sitting.scenario, problem, n_members)
    result["recordings"] = entry(found, estimate, unchecked or sitting.unchecked)
    if text := sitting.store.config().get(VOUCHED):
        result["vouched_sources"] = json.loads(text)
    result["notes"] = list(notes(result))
    write_result(sitting.directory, result)
    return estimate
