"""The methods by name: which goal each serves, and what each can tell."""

from collections.abc import Generator, Mapping, Sequence

from crashrate.errors import InvalidInputError
from crashrate.estimation.strategy import Method, Problem, Query, Snapshot
from crashrate.outcomes import consequence_names
from crashrate.variables import FloatArray, nearest


def _sequential(problem: Problem) -> Generator[Query, FloatArray, Snapshot]:
    from crashrate.estimation.sequential import sequential

    return sequential(problem)


def _huang2017(problem: Problem) -> Generator[Query, FloatArray, Snapshot]:
    from crashrate.estimation.huang2017 import huang2017

    return huang2017(problem)


def _bracket(problem: Problem) -> Generator[Query, FloatArray, Snapshot]:
    from crashrate.estimation.bracket import bracket

    return bracket(problem)


def _crude(problem: Problem) -> Generator[Query, FloatArray, Snapshot]:
    from crashrate.estimation.crude_monte_carlo import crude_monte_carlo

    return crude_monte_carlo(problem)


def _cross_entropy(problem: Problem) -> Generator[Query, FloatArray, Snapshot]:
    from crashrate.estimation.cross_entropy import cross_entropy

    return cross_entropy(problem)


LEARNING = ("sequential",)  # methods that end with a learned crash set, a `Belief`
METHODS: Mapping[str, Method] = {
    "sequential": _sequential,
    "huang2017": _huang2017,
    "crude": _crude,
    "cross-entropy": _cross_entropy,
}
GOALS: Mapping[str, Mapping[str, Method]] = {
    "probability": METHODS,
    "bounds": {"sequential": _bracket},
}
TELL_CONSEQUENCES = ("sequential",)  # that estimate what else a run tells of the event
TELL_MEMBERS = ("sequential",)  # that say what each member of a traffic model makes of the runs


def method_for(method: str, goal: str, *, ordered: bool) -> Method:
    """The generator function that serves the goal by the method.

    Raises
    ------
    InvalidInputError
        If one of them is unknown, or the goal is out of the method's or the order's reach.
    """
    _require_known("method", method, METHODS)
    _require_known("goal", goal, GOALS)
    if method not in GOALS[goal]:
        raise InvalidInputError(
            f"goal: {goal!r} is served by the method {', '.join(GOALS[goal])}, got {method!r}."
        )
    if goal == "bounds" and not ordered:
        raise InvalidInputError(
            "goal: 'bounds' needs a risk order, for only through one do outcomes imply others; "
            "declare it with risk={'v_lead': 'decreasing', …}, or ask for the goal 'probability'."
        )
    return GOALS[goal][method]


def _require_known(what: str, name: str, known: Mapping[str, object]) -> None:
    if not isinstance(name, str) or name not in known:
        raise InvalidInputError(
            f"{what}: expected a known one, got {name!r}{nearest(str(name), tuple(known))}."
        )


def declared(
    consequences: Sequence[str], aim: str | None, method: str, goal: str
) -> tuple[str, ...]:
    """The consequences' names.

    Raises
    ------
    InvalidInputError
        If they are no names, `aim` is none of them, or method and goal know none.
    """
    names = consequence_names(consequences)
    if aim is not None and aim not in names:
        known = nearest(aim, names) if names else ", and none is declared"
        raise InvalidInputError(
            f"aim: expected one of the consequences, got {aim!r}{known}; declare it among the "
            "consequences (in a scenario file under [outcome]), or leave aim out to aim at the "
            "event."
        )
    if names and (method not in TELL_CONSEQUENCES or goal != "probability"):
        raise InvalidInputError(
            "consequences: estimated by the method 'sequential' with the goal 'probability', got "
            f"the method {method!r} with the goal {goal!r}; leave them out, or change these."
        )
    return names
