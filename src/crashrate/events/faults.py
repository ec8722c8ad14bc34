"""Rows that are not kept: what is wrong with them, and whether that is an error."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from crashrate.errors import EventsError
from crashrate.variables import BoolArray

UNITS = "Are the columns in the units of the scenario?"


@dataclass(frozen=True, eq=False)
class Fault:
    """One thing that is wrong with some rows.

    Parameters
    ----------
    reason : str
        As counted, after a number: "12 not closing".
    rows : bool array (n,)
    describe : callable or None
        From a row to what the error says of it; None where such rows are dropped without error.
    """

    reason: str
    rows: BoolArray
    describe: Callable[[int], str] | None


def sift(
    faults: Iterable[Fault], n: int, source: str, *, drop_invalid: bool
) -> tuple[BoolArray, dict[str, int]]:
    """The rows (n,) without fault, and the number dropped by reason; a row counts once.

    Raises
    ------
    EventsError
        For the first fault that is an error, unless `drop_invalid`.
    """
    kept = np.ones(n, dtype=np.bool_)
    dropped: dict[str, int] = {}
    for fault in faults:
        bad = kept & fault.rows
        if not bad.any():
            continue
        if fault.describe is not None and not drop_invalid:
            raise _error(fault.describe, bad, source)
        dropped[fault.reason] = int(bad.sum())
        kept &= ~bad
    return kept, dropped


def _error(describe: Callable[[int], str], bad: BoolArray, source: str) -> EventsError:
    row, n_bad = int(np.argmax(bad)), int(bad.sum())
    rows = "1 such row" if n_bad == 1 else f"{n_bad:,} such rows"
    # nobody's recordings are mostly wrong: what is read is not what is meant
    most = f" {UNITS}" if 2 * n_bad > len(bad) else ""
    return EventsError(
        f"{source}, data row {row + 1}: {describe(row)} ({rows} of {len(bad):,}).{most} Correct "
        "the file, or drop and count such rows with drop_invalid (--drop-invalid)."
    )
