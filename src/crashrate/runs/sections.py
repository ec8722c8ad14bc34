"""The sections of a scenario file: what each may say, and the frozen value it becomes."""

import ast
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from crashrate.errors import InvalidInputError, ScenarioError
from crashrate.estimation.methods import GOALS, METHODS
from crashrate.estimation.strategy import HALF_WIDTH, Problem
from crashrate.expressions import Expression
from crashrate.outcomes import consequence_names
from crashrate.recordings.severity import FACTOR, LEVELS, Severity
from crashrate.runs.keys import Table
from crashrate.variables import Direction, Scale, Variable, nearest

SIMULATOR_KEYS = {
    "acc-aeb": ("kind", "published", "closing_speed_cap", "ego_speed_cap"),
    "python": ("kind", "function", "version"),
}
FUNCTION_EXAMPLE = (
    'function = "my_simulator:crashes", the function crashes in my_simulator.py beside this file'
)
CLOSING = ("inv_ttc", "closing_speed")


@dataclass(frozen=True)
class Target:
    """What is wanted, how tight, how many simulator runs it may cost, and by which method.

    `aim` is the consequence that the target is for; None for the event itself.
    """

    relative_half_width: float = Problem.relative_half_width
    max_calls: int = Problem.max_calls
    confidence: float = Problem.confidence
    method: str = "sequential"
    goal: str = "probability"
    aim: str | None = None


@dataclass(frozen=True)
class SimulatorChoice:
    """Which vehicle is simulated.

    Parameters
    ----------
    kind : {"acc-aeb", "python"}
    published : bool
        The plant with the silent caps of the 2017 study.
    closing_speed_cap, ego_speed_cap : float or None
        Caps of the plant [m/s].
    function : str
        ``"module:function"``, taking rows of the variables.
    version : str
        Of what the function's module calls and its own source does not show: another version is
        another vehicle.
    """

    kind: str
    published: bool = False
    closing_speed_cap: float | None = None
    ego_speed_cap: float | None = None
    function: str = ""
    version: str = ""


@dataclass(frozen=True)
class EventColumns:
    """How a table of events becomes the variables.

    Parameters
    ----------
    columns : mapping
        Variable's name to the expression that computes it from the columns of the file.
    closing : str or None
        The variable that is positive while the range shrinks: other events are dropped.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    closing: str | None = None


@dataclass(frozen=True)
class Outcome:
    """The words of the answer: what happens, per what, and what a run tells beside it."""

    event: str = "crash"
    per: str = "encounter"
    consequences: tuple[str, ...] = ()


def read_variables(section: Table) -> tuple[Variable, ...]:
    """The variables, in order."""
    if not section.values:
        raise section.error("expected at least one table such as [variables.v_lead], got none")
    return tuple(_variable(section.table(name), name) for name in section.values)


def _variable(section: Table, name: str) -> Variable:
    section.only(("unit", "lower", "upper", "scale"))
    lower, upper = section.number("lower", -math.inf), section.number("upper", math.inf)
    unit, scale = section.text("unit", ""), section.text("scale", "linear")
    try:
        return Variable(name, unit, lower, upper, Scale.parse(scale, "scale"))
    except InvalidInputError as error:
        raise ScenarioError(f"{section.where}: {error}") from error


def read_derived(section: Table, names: tuple[str, ...]) -> dict[str, Expression]:
    """Derived quantities as expressions on the variables; each may use the ones above it."""
    derived: dict[str, Expression] = {}
    for name in section.values:
        if not name.isidentifier():
            raise section.error(f"{name!r}: expected a Python identifier such as 'range'")
        text = section.text(name)
        _require_known(section, name, text, (*names, *derived))
        try:
            # the quantity's own name goes in last: the expression checks that it is not taken
            derived[name] = Expression.parse(text, names, derived)
            Expression.parse(name, names, derived)
        except InvalidInputError as error:
            raise ScenarioError(f"{section.where}, {name}: {error}") from error
    return derived


def _require_known(section: Table, name: str, text: str, known: tuple[str, ...]) -> None:
    for word in _names_in(text):
        if word not in known:
            raise section.error(f"{name} = {text!r}: unknown name {word!r}{nearest(word, known)}")


def _names_in(text: str) -> tuple[str, ...]:
    """The names that an expression uses, functions apart; none where it is not one."""
    try:
        tree = ast.parse(text.strip(), mode="eval")
    except (SyntaxError, ValueError):  # said better by Expression
        return ()
    called = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    found = [n.id for n in ast.walk(tree) if isinstance(n, ast.Name) and id(n) not in called]
    return tuple(dict.fromkeys(found))


def read_risk(root: Table, known: tuple[str, ...]) -> Mapping[str, Direction] | None:
    """The declared directions, None where the file has no such section."""
    if "risk" not in root.values:
        return None
    section = root.table("risk").only(known, "variable or derived quantity")
    if not section.values:
        raise section.error("expected name = direction; leave it out where no order is claimed")
    try:
        directions = {
            n: Direction.parse(section.text(n), f"{section.where}, {n}") for n in section.values
        }
    except ScenarioError:
        raise
    except InvalidInputError as error:
        raise ScenarioError(str(error)) from error
    return MappingProxyType(directions)


def read_simulator(section: Table) -> SimulatorChoice:
    """The simulator, with the keys of its kind."""
    if not section.values:
        raise section.error(
            "expected the vehicle under test, such as kind = 'python' and function = "
            "'my_vehicle:simulate', got nothing"
        )
    kind = section.text("kind")
    if kind not in SIMULATOR_KEYS:
        raise section.error(f"unknown kind {kind!r}{nearest(kind, tuple(SIMULATOR_KEYS))}")
    section.only(SIMULATOR_KEYS[kind])
    if kind == "python":
        if "function" not in section.values:
            raise section.error(f"expected {FUNCTION_EXAMPLE}, got no function")
        return SimulatorChoice(
            kind, function=section.text("function"), version=section.text("version", "")
        )
    caps = {key: section.optional_number(key) for key in ("closing_speed_cap", "ego_speed_cap")}
    published = section.flag("published", False)
    if published and any(cap is not None for cap in caps.values()):
        raise section.error("published = true sets both caps; give either it or the caps")
    return SimulatorChoice(kind, published, caps["closing_speed_cap"], caps["ego_speed_cap"])


def read_target(section: Table) -> Target:
    """The target, the budget, the method and the goal."""
    section.only(("relative_half_width", "max_calls", "confidence", "method", "goal", "aim"))
    target = Target(
        section.number("relative_half_width", Target.relative_half_width),
        section.integer("max_calls", Target.max_calls),
        section.number("confidence", Target.confidence),
        section.text("method", Target.method),
        section.text("goal", Target.goal),
        section.text("aim") if "aim" in section.values else None,
    )
    if target.method not in METHODS:
        raise section.error(
            f"unknown method {target.method!r}{nearest(target.method, tuple(METHODS))}"
        )
    if target.goal not in GOALS:
        raise section.error(
            f"goal: unknown goal {target.goal!r}{nearest(target.goal, tuple(GOALS))}"
        )
    checks = (
        (0 < target.relative_half_width <= 1, "relative_half_width", HALF_WIDTH),
        (target.max_calls >= 1, "max_calls", "at least 1"),
        (0 < target.confidence < 1, "confidence", "a number between 0 and 1"),
    )
    for holds, key, expected in checks:
        if not holds:
            raise section.error(f"{key}: expected {expected}, got {getattr(target, key)}")
    return target


def read_events(section: Table, names: tuple[str, ...]) -> EventColumns:
    """How a table of events becomes the variables `names`."""
    section.only(("columns", "closing"))
    columns = section.table("columns").only(names, "variable")
    texts = {name: _column(columns, name) for name in columns.values}
    closing = section.text("closing", "")
    if closing and closing not in names:
        raise section.error(f"closing: unknown variable {closing!r}{nearest(closing, names)}")
    default = next((name for name in CLOSING if name in names), None)
    return EventColumns(MappingProxyType(texts), closing or default)


def _column(columns: Table, name: str) -> str:
    text = columns.text(name)
    try:
        # which columns the file has is known when it is read: here any name will do
        Expression(text, _names_in(text))
    except InvalidInputError as error:
        raise ScenarioError(f"{columns.where}, {name}: {error}") from error
    return text


def read_severity(root: Table, names: tuple[str, ...], closing: str | None) -> Severity | None:
    """How a recorded event is made worse; by default its closing is multiplied."""
    if "severity" not in root.values:
        return None if closing is None else Severity.multiplying(closing, names)
    section = root.table("severity").only((*names, "levels"), "variable")
    levels = tuple(section.numbers("levels", LEVELS))
    known = (*names, FACTOR)
    try:
        changed = {
            name: Expression(section.text(name), known)
            for name in section.values
            if name != "levels"
        }
        return Severity(names, MappingProxyType(changed), levels)
    except InvalidInputError as error:
        raise ScenarioError(f"{section.where}: {error}") from error


def read_outcome(section: Table) -> Outcome:
    """The words of the answer, and the consequences that are told beside the event."""
    section.only(("event", "per", "consequences"))
    texts = section.texts("consequences")
    try:
        names = consequence_names(texts)
    except InvalidInputError as error:
        raise ScenarioError(f"{section.where}: {error}") from error
    event, per = section.text("event", Outcome.event), section.text("per", Outcome.per)
    for key, word in (("event", event), ("per", per)):
        if not word.strip():
            raise section.error(f"{key}: expected a word for the answer's sentence, got {word!r}")
    if event in names:
        raise section.error(f"consequences: expected other names than that of the event, {event!r}")
    return Outcome(event, per, names)


def require_aim(root: Table, target: Target, outcome: Outcome) -> None:
    """Refuse an aim that is no consequence."""
    if target.aim is not None and not outcome.consequences:
        raise root.table("target").error(
            f"aim: got {target.aim!r}, and [outcome] declares no consequences; declare it there, "
            "or leave it out to aim at the event"
        )
    if target.aim is not None and target.aim not in outcome.consequences:
        raise root.table("target").error(
            f"aim: expected one of the consequences under [outcome], got {target.aim!r}"
            f"{nearest(target.aim, outcome.consequences)}; leave it out to aim at the event"
        )
