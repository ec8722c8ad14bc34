"""The configuration of a run: what must be equal for a run folder to be continued."""

import hashlib
import json
from importlib.metadata import version
from pathlib import Path
from platform import python_version
from typing import Any, TypeVar

import numpy as np

from crashrate.errors import InvalidInputError, ScenarioError, StoreError
from crashrate.estimation.campaign import Campaign
from crashrate.estimation.strategy import Problem
from crashrate.runs.scenario import Scenario
from crashrate.traffic.model import TrafficModel

Number = TypeVar("Number", int, float)

TRAFFIC = "traffic model"
SOURCE = "simulator_source"
TARGETS, BUDGETS = "targets", "budgets"
GOAL, AIM = "goal", "aim"
VOUCHED = "vouched_sources"  # edited since, their outcomes kept at the user's word


def versions() -> dict[str, str]:
    """Versions of what the numbers depend on."""
    packages = {name: version(name) for name in ("crashrate", "numpy", "scipy")}
    return packages | {"python": python_version()}


def require_same_variables(scenario: Scenario, traffic: TrafficModel) -> None:
    """Refuse a traffic model of other variables or bounds than the scenario's.

    Raises
    ------
    InvalidInputError
        Naming both.
    """
    if tuple(traffic.names) != scenario.names:
        raise InvalidInputError(
            f"traffic model: expected the variables of the scenario {scenario.name!r}, "
            f"({', '.join(scenario.names)}), got ({', '.join(traffic.names)}); fit one with "
            "'crashrate fit EVENTS --scenario SCENARIO --out traffic.json' ('published' is in the "
            "variables of examples/huang2017.toml and examples/own_vehicle.toml)."
        )
    for variable, scale in zip(scenario.variables, traffic.scales.each, strict=True):
        if variable.scale is not scale:
            raise InvalidInputError(
                f"traffic model: expected the scale of the scenario {scenario.name!r}, "
                f"{variable.scale.value!r} for {variable.name}, got {scale.value!r}; fit one for "
                "this scenario."
            )
    for side in ("lower", "upper"):
        wanted, got = np.array(getattr(scenario, side)), np.asarray(getattr(traffic, side))
        for name, want, have in zip(scenario.names, wanted, got, strict=True):
            if not np.isclose(want, have, rtol=1e-9, atol=0.0):
                raise InvalidInputError(
                    f"traffic model: expected the bounds of the scenario {scenario.name!r}, "
                    f"{side} = {want:g} for {name}, got {have:g}; fit one for this "
                    "scenario, or give the scenario the bounds of the model."
                )


def configuration(
    scenario: Scenario, traffic: TrafficModel, campaign: Campaign, source: str = ""
) -> dict[str, str]:
    """What the store keeps of a run, key to text; `source` is the hash of the simulator's."""
    problem = campaign.problem
    return {
        "scenario_name": scenario.name,
        "scenario": scenario.to_text(),
        "traffic": traffic.to_json(),
        "seed": str(problem.seed),
        "method": campaign.method,
        GOAL: campaign.goal,
        AIM: problem.aim or "",
        "batch_size": str(problem.batch_size),
        "versions": json.dumps(versions()),
        "target": target_text(problem),
        SOURCE: source,
    }


def target_text(problem: Problem) -> str:
    """Target and budget: a run may go on with others, where its method allows that."""
    return f"± {100 * problem.relative_half_width:g} % in {problem.max_calls} simulator runs"


def targets(
    stored: dict[str, str], n_stored: int, target: Number, key: str = TARGETS
) -> list[tuple[Number, int]]:
    """Every half-width that a run aimed at, and after how many simulator runs: `target` last.

    Likewise every budget, stored under another `key`.
    """
    kind = type(target)
    before = [(kind(t), int(n)) for t, n in json.loads(stored.get(key, "[]"))]
    if before and before[-1][0] == target:
        return before
    kept = [(t, n) for t, n in before if n < n_stored]
    kept.append((target, n_stored if kept else 0))
    return kept


def require_same_run(directory: Path, stored: dict[str, str], asked: dict[str, str]) -> None:
    """Refuse to continue the run of another configuration.

    Raises
    ------
    StoreError
        Saying what differs and what to do.
    """
    differences = _differences(stored, asked)
    if differences:
        raise StoreError(
            f"{directory}: holds a run of another configuration: {'; '.join(differences)}. "
            "Choose another --out, or give the arguments of the run that is there."
        )


def require_same_source(directory: Path, stored: dict[str, str], asked: dict[str, str]) -> None:
    """Refuse to mix the outcomes of a simulator with those of its edited self.

    Raises
    ------
    StoreError
        Saying that its source changed and what to do.
    """
    had, has = stored.get(SOURCE, ""), asked.get(SOURCE, "")
    if had and has and had != has:
        raise StoreError(
            f"{directory}: its outcomes come from a simulator that was edited since: the file of "
            "the [simulator] function, with those beside it that it imports, had the SHA-256 "
            f"{had[:12]}…, now {has[:12]}…. Choose another --out to simulate the new one, restore "
            "the files to go on with the old, or give --same-vehicle if the edit changes no "
            "outcome that is stored."
        )


def vouched(stored: dict[str, str], n_runs: int) -> str:
    """The sources that were edited with their outcomes kept, one more: JSON for the store."""
    before = json.loads(stored.get(VOUCHED, "[]"))
    return json.dumps([*before, {"sha256": stored.get(SOURCE, ""), "n_runs": n_runs}])


def require_budget(directory: Path, n_stored: int, stored: str | None, problem: Problem) -> None:
    """Refuse a new budget below what is stored: the result there would be lost.

    Raises
    ------
    StoreError
        Naming both numbers.
    """
    max_calls = problem.max_calls
    if stored != target_text(problem) and max_calls < n_stored:
        raise StoreError(
            f"{directory}: holds {n_stored} simulator runs, more than the budget of {max_calls} "
            "asked for; its result is kept as it is. Read it with 'crashrate status', ask for "
            f"--max-calls {n_stored} or more, or choose another --out."
        )


def _differences(stored: dict[str, str], asked: dict[str, str]) -> list[str]:
    had, has = _identity(stored), _identity(asked)
    return [
        f"{key}: has {_words(key, had, stored)}, asked for {_words(key, has, asked)}"
        for key in has
        if had[key] != has[key]
    ]


def _words(key: str, identity: dict[str, Any], config: dict[str, str]) -> str:
    return _traffic_words(identity, config) if key == TRAFFIC else _short(identity[key])


def _traffic_words(identity: dict[str, Any], config: dict[str, str]) -> str:
    """Two models may begin with the same numbers: size, source and a hash tell them apart."""
    numbers = identity[TRAFFIC]
    provenance = json.loads(config["traffic"]).get("provenance") or {}
    source = (provenance.get("events") or {}).get("source") or provenance.get("description")
    digest = hashlib.sha256(json.dumps(numbers, sort_keys=True).encode()).hexdigest()[:8]
    of = f" from {source}" if source else ""
    n = len(numbers.get("weights", ()))
    return f"{n} component{'' if n == 1 else 's'}{of} (hash {digest})"


def _identity(config: dict[str, str]) -> dict[str, Any]:
    try:
        scenario = Scenario.from_text(config["scenario"], config["scenario_name"])
        traffic = json.loads(config["traffic"])
        plain = {key: config[key] for key in ("seed", "method", "batch_size")}
        plain[GOAL] = config.get(GOAL, "probability")  # older runs had no other
        plain[AIM] = config.get(AIM) or "the event"
    except (KeyError, ValueError, ScenarioError) as error:
        raise StoreError(
            f"run folder: expected a configuration written by crashrate, got: {error}; restore "
            "the folder from a copy, or choose another --out."
        ) from error
    for model in (traffic, *traffic.get("members", ())):
        model.pop("provenance", None)  # where the numbers came from changes no number
    return scenario.identity | plain | {TRAFFIC: traffic}


def _short(value: Any, limit: int = 80) -> str:
    text = json.dumps(value)
    return text if len(text) <= limit else f"{text[:limit]}…"
