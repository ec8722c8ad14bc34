"""From a file to the events of a traffic model: which rows are kept, and why the others are not."""

import os
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from crashrate.errors import EventsError, ExpressionError
from crashrate.events.faults import UNITS, Fault, sift
from crashrate.events.sources import Column, Source, open_source
from crashrate.events.table import EventTable
from crashrate.expressions import Expression
from crashrate.variables import FloatArray, Variable, nearest

MIN_EVENTS = 2
NOT_CLOSING = "not closing"  # rows that are no encounter, and nothing is wrong with
# Of the encounters: if more were dropped as invalid, those that are left are no fair sample.
INVALID_SHARE = 0.1


def read_events(
    path: str | os.PathLike[str],
    variables: Sequence[Variable],
    columns: Mapping[str, str] | None = None,
    *,
    closing: str | None = None,
    drop_invalid: bool = False,
) -> EventTable:
    """The events in a CSV, Parquet or MATLAB .mat file.

    Rows that are not closing are dropped and counted. A cell that is no finite number and a row
    outside the bounds are errors, unless `drop_invalid` drops and counts them too, by reason.

    Parameters
    ----------
    path : path
        Ends in .csv (comma-separated, with a header), .parquet or .mat (version 5 to 7).
    variables : sequence of Variable, length d
        The bounds belong to the box.
    columns : mapping, optional
        Variable's name to arithmetic on the file's columns, such as ``{"inv_range": "1 / range",
        "inv_ttc": "-range_rate / range"}`` (TTC = -R/Ṙ, eq. (1) of the 2017 paper). A variable
        that is not in it is the file's column of its name.
    closing : str, optional
        Variable that is positive while the range shrinks; without it every row counts.
    drop_invalid : bool

    Raises
    ------
    EventsError
        The message names the file, the data row (the first one under the header is 1; blank lines
        are not counted), the column and the value.
    """
    path = Path(path)
    names = tuple(variable.name for variable in variables)
    _check_names(path, names, columns or {}, closing)
    source = open_source(path)
    expressions = [_expression(path, source, name, (columns or {}).get(name)) for name in names]
    used = tuple(dict.fromkeys(name for e in expressions for name in e.used))
    cells = source.read(used)
    values = _evaluate(expressions, cells)
    values, n_on_bound = _lay_on_bounds(values, variables, expressions, cells)
    faults = (
        *_unreadable_cells(cells),
        *_not_closing(values, names, closing),
        *_undefined(values, expressions, names, cells),
        *_out_of_bounds(values, variables),
    )
    kept, dropped = sift(faults, len(values), str(path), drop_invalid=drop_invalid)
    _require_events(path, len(values), int(kept.sum()), dropped)
    rows = np.flatnonzero(kept)
    return EventTable(names, values[rows], str(path), rows, dropped, int(n_on_bound[rows].sum()))


def invalid_share(n_events: int, dropped: Mapping[str, int]) -> float:
    """Share of the recorded encounters that were dropped, by reason, because they are invalid."""
    invalid = sum(n for reason, n in dropped.items() if reason != NOT_CLOSING)
    return invalid / (n_events + invalid) if invalid else 0.0


# --- columns


def _check_names(
    path: Path, names: tuple[str, ...], columns: Mapping[str, str], closing: str | None
) -> None:
    if not names:
        raise EventsError(f"{path}: expected at least one variable to read, got none.")
    asked = [*columns] if closing is None else [*columns, closing]
    for name in asked:
        if name not in names:
            raise EventsError(f"{path}: events: {name!r} is not a variable{nearest(name, names)}.")


def _expression(path: Path, source: Source, name: str, text: str | None) -> Expression:
    """How variable `name` is computed from the columns of the file that it uses."""
    if text is None and name not in source.names:
        raise EventsError(
            f"{path}: no column {name!r}{nearest(name, source.names)}; where the file calls it "
            "otherwise, or it can be computed, say so under [events.columns], such as "
            f'{name} = "{_first_name(source)} / 3.6".{_without_header(source)}'
        )
    usable = tuple(column for column in source.names if column.isidentifier())
    try:
        expression = Expression(name if text is None else text, usable)
    except ExpressionError as error:
        raise EventsError(f"{path}: variable {name!r}: {error}") from error
    if not expression.used:
        raise EventsError(
            f"{path}: variable {name!r}: expected arithmetic on columns of the file, got the "
            f"constant {expression.text!r}."
        )
    return Expression(expression.text, expression.used)


def _without_header(source: Source) -> str:
    """A hint where the names are numbers: the first row of a table without names was taken."""
    if not source.names or not all(map(_is_number, source.names)):
        return ""
    return " The first row is taken for the columns' names: add a row of names above it."


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _first_name(source: Source) -> str:
    return next((name for name in source.names if name.isidentifier()), "column")


def _evaluate(expressions: Sequence[Expression], cells: Mapping[str, Column]) -> FloatArray:
    """The variables (n, d), computed in double precision."""
    columns = [
        expression(np.stack([cells[name].values for name in expression.used], axis=1))
        for expression in expressions
    ]
    return np.stack(columns, axis=1)


def _lay_on_bounds(
    values: FloatArray,
    variables: Sequence[Variable],
    expressions: Sequence[Expression],
    cells: Mapping[str, Column],
) -> tuple[FloatArray, FloatArray]:
    """Values that lie beyond a bound by less than the rounding of their single precision.

    A range of 0.1 stored in single precision is 0.10000000149: beyond an upper bound of 0.1, yet
    the same number as far as the file knows. Returns the values and how many moved in each row.
    """
    laid, moved = values.copy(), np.zeros(len(values))
    for k, (variable, expression) in enumerate(zip(variables, expressions, strict=True)):
        if not any(cells[name].single for name in expression.used):
            continue
        with np.errstate(over="ignore"):  # beyond single precision is inf, which is no bound
            column = values[:, k].astype(np.float32)
        for bound, outside in (
            (variable.lower, values[:, k] < variable.lower),
            (variable.upper, values[:, k] > variable.upper),
        ):
            same = outside & (column == np.float32(bound))
            laid[same, k] = bound
            moved += same
    return laid, moved


# --- faults


def _unreadable_cells(cells: Mapping[str, Column]) -> Iterable[Fault]:
    for name, column in cells.items():
        unreadable = ~np.isfinite(column.values)
        say = partial(_say_unreadable, name, column)
        yield Fault(f"with {name} not a finite number", unreadable, say)


def _say_unreadable(name: str, column: Column, row: int) -> str:
    return f"column {name!r}: expected a finite number, got {column.cell(row)}"


def _not_closing(
    values: FloatArray, names: tuple[str, ...], closing: str | None
) -> Iterable[Fault]:
    if closing is not None:
        yield Fault(NOT_CLOSING, values[:, names.index(closing)] <= 0.0, describe=None)


def _undefined(
    values: FloatArray,
    expressions: Sequence[Expression],
    names: tuple[str, ...],
    cells: Mapping[str, Column],
) -> Iterable[Fault]:
    for name, expression, column in zip(names, expressions, values.T, strict=True):
        say = partial(_say_undefined, name, expression, cells, column)
        yield Fault(f"with {name} undefined", ~np.isfinite(column), say)


def _say_undefined(
    name: str, expression: Expression, cells: Mapping[str, Column], values: FloatArray, row: int
) -> str:
    given = ", ".join(f"{column} = {cells[column].cell(row)}" for column in expression.used)
    return f"{name} = {expression.text} is {values[row]} at {given}: expected a finite number"


def _out_of_bounds(values: FloatArray, variables: Sequence[Variable]) -> Iterable[Fault]:
    for variable, column in zip(variables, values.T, strict=True):
        outside = (column < variable.lower) | (column > variable.upper)
        say = partial(_say_outside, variable, column)
        yield Fault(f"with {variable.name} out of bounds", outside, say)


def _say_outside(variable: Variable, values: FloatArray, row: int) -> str:
    bounds = f"{variable.lower} to {variable.upper} {variable.unit}".rstrip()
    return f"variable {variable.name!r}: expected {bounds}, got {values[row]}"


def _require_events(path: Path, n_read: int, n_kept: int, dropped: Mapping[str, int]) -> None:
    if n_kept >= MIN_EVENTS:
        return
    if not dropped:
        rows = "1 row" if n_read == 1 else f"{n_read} rows"
        raise EventsError(f"{path}: expected at least {MIN_EVENTS} events, got {rows}.")
    why = ", ".join(f"{n:,} {reason}" for reason, n in dropped.items())
    raise EventsError(
        f"{path}: expected at least {MIN_EVENTS} events, got {n_kept} of {n_read:,} rows ({why}); "
        f"{UNITS[0].lower()}{UNITS[1:]}"
    )
