"""What a simulator run comes to: whether the event happened, and the consequences it had.

A table (n, 1 + K): the event (1, 0, or NaN where the simulation failed), then K consequences,
numbers in [0, 1] that are 0 where the event did not happen.
"""

import reprlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from crashrate.errors import CrashrateError, InvalidInputError
from crashrate.variables import FloatArray

Told: TypeAlias = npt.ArrayLike | Mapping[str, npt.ArrayLike]


def consequence_names(names: Sequence[str]) -> tuple[str, ...]:
    """`names` as a tuple.

    Raises
    ------
    InvalidInputError
        If they are not different texts.
    """
    several = isinstance(names, Iterable) and not isinstance(names, str)
    if not several or not all(isinstance(n, str) and n.strip() for n in names):
        raise InvalidInputError(
            f"consequences: expected names, such as ('injury',), got {names!r}."
        )
    if len(set(names)) < len(names):
        raise InvalidInputError(f"consequences: expected different names, got {tuple(names)!r}.")
    return tuple(names)


def what_came(array: npt.NDArray[np.generic]) -> str:
    """What a message says of an array of the wrong shape."""
    if array.shape == () and array.item() is None:
        return "None (does the function return what it computes?)"
    return f"shape {array.shape} of dtype {array.dtype}"


def event_alone(told: Told) -> Told:
    """What a mapping holds that tells of nothing but the event; anything else as it is."""
    if isinstance(told, Mapping) and len(told) == 1:
        return next(iter(told.values()))
    return told


def _outcomes(n: int) -> str:
    return "1 outcome, for 1 situation" if n == 1 else f"{n} outcomes, one per situation asked for"


def told_table(told: Told, n: int, names: Sequence[str]) -> FloatArray:
    """What a campaign is told, as a table (n, 1 + K); without names, (n,) outcomes alone.

    Raises
    ------
    InvalidInputError
        As `outcome_table`.
    """
    if names:
        return outcome_table(told, n, names, "tell", InvalidInputError)
    told = event_alone(told)
    if isinstance(told, Mapping):
        raise InvalidInputError(
            f"tell: expected {_outcomes(n)}, got a mapping of {', '.join(map(str, told))}; declare "
            "what it holds beside the event, as in consequences=('injury',)."
        )
    try:
        array = np.asarray(told)
    except ValueError:
        raise InvalidInputError(
            f"tell: expected {_outcomes(n)}, got {reprlib.repr(told)}, of unequal lengths."
        ) from None
    if array.shape != (n,):
        raise InvalidInputError(f"tell: expected {_outcomes(n)}, got {what_came(array)}.")
    if array.dtype.kind not in "biuf":
        raise InvalidInputError(
            f"tell: expected True, False or NaN (failed), got dtype {array.dtype}, such as "
            f"{array[0]!r}."
        )
    y = array.astype(np.float64)
    bad = np.flatnonzero(~(np.isnan(y) | (y == 0) | (y == 1)))
    if len(bad):
        raise InvalidInputError(
            f"tell: expected True, False or NaN (failed), got {y[bad[0]]} at row {bad[0]}; where "
            "the simulator gives a probability draw the outcome by it, where it gives a margin "
            "compare that with its limit."
        )
    return y[:, None]


def outcome_table(
    told: Told, n: int, names: Sequence[str], what: str, error: type[CrashrateError]
) -> FloatArray:
    """Outcomes with consequences `names` as a table (n, 1 + K).

    Parameters
    ----------
    told : array (n, 1 + K), or mapping of names to arrays (n,)
        A mapping has the consequences' names and one more key, whatever it is called: the event.
        Where the event is NaN the simulation failed, and the whole row becomes NaN.
    n : int
        Number of situations.
    names : sequence of str
        Of the K consequences, in order.
    what : str
        Names the giver in messages.
    error : type
        The exception that is raised.

    Raises
    ------
    CrashrateError
        Of type `error`, if the shape is another, the event is not 0, 1 or NaN, a consequence is
        not in [0, 1], or above 0 where the event did not happen.
    """
    table = _as_table(told, n, names, what, error).copy()
    event = table[:, 0]
    failed = np.isnan(event)
    if len(odd := np.flatnonzero(~(failed | (event == 0) | (event == 1)))):
        raise error(
            f"{what}: expected the event as True, False or NaN (failed) in the first column, got "
            f"{event[odd[0]]} at row {odd[0]}."
        )
    table[failed] = np.nan
    for name, column in zip(names, table[:, 1:].T, strict=True):
        _check(name, column, event, what, error)
    return table


def _as_table(
    told: Told, n: int, names: Sequence[str], what: str, error: type[CrashrateError]
) -> FloatArray:
    shape = (n, 1 + len(names))
    columns = ", ".join(("the event", *names))
    parts = _columns(told, names, what, error) if isinstance(told, Mapping) else None
    try:
        if parts is not None:
            told = np.stack([_each(key, part, n, what, error) for key, part in parts], axis=-1)
        table = np.asarray(told)
    except ValueError as why:
        raise error(
            f"{what}: expected an array of numbers of shape {shape} ({columns}), got {why}."
        ) from why
    if table.dtype.kind not in "biuf":
        raise error(f"{what}: expected numbers ({columns}), got dtype {table.dtype}.")
    if table.shape != shape:
        raise error(
            f"{what}: expected shape {shape}, a row for each situation with the columns {columns}, "
            f"got shape {table.shape}."
        )
    return table.astype(np.float64)


def _columns(
    told: Mapping[str, npt.ArrayLike],
    names: Sequence[str],
    what: str,
    error: type[CrashrateError],
) -> list[tuple[str, npt.ArrayLike]]:
    events = [key for key in told if key not in names]
    if len(events) != 1 or len(told) != 1 + len(names):
        raise error(
            f"{what}: expected the keys {', '.join(names)} and one more for the event, got "
            f"{', '.join(map(str, told)) or 'none'}."
        )
    return [(key, told[key]) for key in (events[0], *names)]


def _each(
    key: str, part: npt.ArrayLike, n: int, what: str, error: type[CrashrateError]
) -> npt.NDArray[Any]:
    """What is told under one name: a value for each situation."""
    array = np.asarray(part)
    if array.shape != (n,):
        raise error(
            f"{what}: expected {n} values under {key!r}, one per situation, got {what_came(array)}."
        )
    return array


def _check(
    name: str, column: FloatArray, event: FloatArray, what: str, error: type[CrashrateError]
) -> None:
    known = ~np.isnan(event)
    if len(odd := np.flatnonzero(known & np.isnan(column))):
        raise error(
            f"{what}: expected {name!r} in [0, 1], got nan at row {odd[0]}; return 0 where the "
            "event did not happen, and mark a run that failed by NaN as its event."
        )
    if len(odd := np.flatnonzero(known & ~((column >= 0) & (column <= 1)))):
        raise error(
            f"{what}: expected {name!r} in [0, 1], got {column[odd[0]]} at row {odd[0]}; divide "
            "it by the largest value that matters (far smaller means cost more runs)."
        )
    if len(odd := np.flatnonzero(known & (event == 0) & (column > 0))):
        raise error(
            f"{what}: expected {name!r} to be 0 where the event did not happen, got "
            f"{column[odd[0]]} at row {odd[0]}; let the event be the widest (the near miss), and "
            "declare the narrower one (the crash) as a consequence of it."
        )
