"""From events to a traffic model that remembers where it comes from."""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from crashrate.errors import InvalidInputError, NumericalError
from crashrate.events import EventTable, read_events
from crashrate.recordings.check import n_duplicates
from crashrate.runs.recorded import digest
from crashrate.runs.scenario import Scenario
from crashrate.traffic.model import TrafficModel

if TYPE_CHECKING:
    from crashrate.traffic.ensemble import Failed, Fitted, OnStep

AUTO = tuple(range(1, 16))
EVENTS_PER_COMPONENT = 10  # fewer are refused
EVENTS_PER_PARAMETER = 10  # fewer are warned of
N_SAMPLE = 2000  # events kept with the model, for plots


def parse_components(text: str) -> tuple[int, ...]:
    """Numbers of components to try: ``"9"``, ``"1:15"`` (both ends included) or ``"auto"``.

    Raises
    ------
    InvalidInputError
        If `text` is none of these.
    """
    if text == "auto":
        return AUTO
    first, colon, last = text.partition(":")
    try:
        low = int(first)
        high = int(last) if colon else low
    except ValueError:
        low, high = 0, 0
    if not 1 <= low <= high:
        raise InvalidInputError(
            f"components: expected a number such as 9, a range such as 1:15, or auto, got {text!r}."
        )
    return tuple(range(low, high + 1))


def require_enough(
    events: EventTable, components: Sequence[int], path: str | Path = "events"
) -> None:
    """Refuse to fit components to fewer than ten events each, or to a variable that is constant.

    Raises
    ------
    InvalidInputError
        Naming the file and the option.
    """
    _require_varied(events, path)
    most = len(events) // EVENTS_PER_COMPONENT
    if max(components) <= most:
        return
    advice = f", or a smaller --components (up to {most}, better fewer)" if most else ""
    raise InvalidInputError(
        f"{path}: expected at least {EVENTS_PER_COMPONENT} events for each of {max(components)} "
        f"components, got {len(events)} events; give more events{advice}."
    )


def _require_varied(events: EventTable, path: str | Path) -> None:
    """Refuse a variable that is the same in every event: it has no density."""
    for name, column in zip(events.names, events.values.T, strict=True):
        if column.min() == column.max():
            raise InvalidInputError(
                f"{path}: expected events that differ in {name!r}, got {column[0]:g} in all "
                f"{len(events):,}; look at the column, or leave the variable out of the scenario."
            )


def tried(text: str, events: EventTable) -> tuple[int, ...]:
    """Numbers of components to try: of "auto" those that the events can hold, one at least."""
    numbers = parse_components(text)
    most = max(len(events) // EVENTS_PER_COMPONENT, 1)
    return tuple(n for n in numbers if n <= most) if text == "auto" else numbers


def thin_data(n_events: int, n_components: int, n_variables: int) -> str:
    """A warning where a fit rests on fewer than ten events per parameter; else empty."""
    d = n_variables
    free = n_components * (1 + d + d * (d + 1) // 2) - 1  # the weights add up to 1
    if n_events >= EVENTS_PER_PARAMETER * free:
        return ""
    return (
        f"{n_events} events for the {free} free parameters of {n_components} components: fewer "
        f"than {EVENTS_PER_PARAMETER} each, so the model's tails, and any probability from them, "
        "are rough. Give more events, or a smaller --components."
    )


def read_scenario_events(
    scenario: Scenario, path: str | Path, *, drop_invalid: bool = False
) -> EventTable:
    """The events at `path` in the variables of `scenario`; see `events.read_events`."""
    return read_events(
        path,
        scenario.variables,
        scenario.events.columns,
        closing=scenario.events.closing,
        drop_invalid=drop_invalid,
    )


def fit_traffic(
    scenario: Scenario,
    events: EventTable,
    components: Sequence[int],
    *,
    seed: int = 0,
    synthetic: bool = False,
    n_restarts: int = 1,
    n_members: int = 0,
    workers: int | None = 1,
    on_step: "OnStep | None" = None,
) -> TrafficModel:
    """Fit a truncated mixture to events: the number of components with the lowest BIC.

    Parameters
    ----------
    scenario : Scenario
        Gives the box.
    events : EventTable
        In the scenario's variables.
    components : sequence of int
        Numbers of components to try.
    seed : int
        Of the fits' starts.
    synthetic : bool
        Whether the events were drawn, not recorded: the model says so.
    n_restarts : int
        Fits of each number of components, from different starts.
    n_members : int
        Fits of re-weighted events that the model carries as its members, beside itself.
    workers : int or None
        Processes; the result is the same whatever their number. None for as many as are worth it.
    on_step : callable, optional
        As of `select_components`.

    Returns
    -------
    TrafficModel
        Its provenance holds "events" (source, counts and a sample for plots) and "selection" (the
        criterion and the held-out log likelihood of every number tried).

    Raises
    ------
    InvalidInputError
        If there are fewer events than components.
    NumericalError
        If no fit comes to an end: every start collapses, or every fit of re-weighted events.
    """
    from threadpoolctl import threadpool_limits

    from crashrate.traffic.components import select_components
    from crashrate.traffic.ensemble import fit_tasks, member_tasks, with_members

    parameters = {
        "lower": scenario.lower,
        "upper": scenario.upper,
        "scales": [v.scale.value for v in scenario.variables],
    }
    # one thread: the same bits on every machine's number of cores, so that a run can be resumed
    with threadpool_limits(limits=1):
        selection = select_components(
            events.values,
            components,
            on_step=on_step,
            n_restarts=n_restarts,
            workers=workers,
            random_state=seed,
            **parameters,
        )
        model = selection.traffic_model(scenario.names)
        provenance = {**model.provenance, "events": _origin(events, synthetic, seed)}
        model = replace(model, provenance=provenance)
        if not n_members:
            return model
        tasks = member_tasks(n_members, selection.admissible, seed)
        say = _of_further_fits(on_step)
        found = fit_tasks(tasks, events.values, parameters, workers=workers, on_step=say)
    return with_members(model, _members(found))


def _of_further_fits(on_step: "OnStep | None") -> "OnStep | None":
    """`on_step`, whose message says that these are not the fits before, counted anew."""
    if on_step is None:
        return None
    return lambda done, total, message: on_step(done, total, f"to re-weighted events, {message}")


def _members(found: "Sequence[Fitted | Failed]") -> "list[Fitted]":
    """The further fits that came to an end; warns of the others.

    Raises
    ------
    NumericalError
        If there are none.
    """
    from crashrate.traffic.ensemble import Failed, Fitted

    fits = [fit for fit in found if isinstance(fit, Fitted)]
    failed = [fit for fit in found if isinstance(fit, Failed)]
    if not fits:
        raise NumericalError(f"every further fit failed; fit without them. {failed[0].reason}")
    if failed:
        warnings.warn(
            f"{len(failed)} of {len(found)} further fits failed, and are left out.", stacklevel=3
        )
    if stuck := sum(not fit.converged for fit in fits):
        warnings.warn(
            f"{stuck} of {len(found)} further fits did not converge; they count as they are.",
            stacklevel=3,
        )
    return fits


def _origin(events: EventTable, synthetic: bool, seed: int) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    n = min(N_SAMPLE, len(events))
    sample = events.values[np.sort(rng.choice(len(events), n, replace=False))]
    return {
        "source": events.source,
        "n": len(events),
        "n_duplicates": n_duplicates(events.values),
        "sha256": digest(events),
        "dropped": dict(events.dropped),
        "synthetic": synthetic,
        "sample": sample.tolist(),
    }
