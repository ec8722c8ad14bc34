"""Files of columns: what every reader offers, and which reader is for which file."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from crashrate.errors import EventsError
from crashrate.variables import FloatArray


@dataclass(frozen=True, eq=False)
class Column:
    """One column of a file as numbers, with what the file says where it is not a number.

    Parameters
    ----------
    values : array (n,)
        NaN where a cell is empty or not a number.
    raw : sequence, length n
        The cells as the file has them, for error messages.
    single : bool
        The file holds single-precision numbers.
    """

    values: FloatArray
    raw: Any
    single: bool = False

    def cell(self, row: int) -> str:
        """The cell at `row` as an error message shows it."""
        value = self.raw[row]
        value = value.as_py() if hasattr(value, "as_py") else value
        return "an empty cell" if value is None or value == "" else _short(value)


def _short(value: Any) -> str:
    text = repr(value) if isinstance(value, str) else str(value)
    return text if len(text) <= 40 else f"{text[:40]}…"


class Source(Protocol):
    """A file whose columns are read by name."""

    @property
    def names(self) -> tuple[str, ...]:
        """The columns of the file, in its order."""

    def read(self, names: Sequence[str]) -> dict[str, Column]:
        """The columns `names`; EventsError where one does not hold numbers."""


def open_source(path: Path) -> Source:
    """The reader of the file at `path`, by its ending.

    Raises
    ------
    EventsError
        If there is no such file, no reader for it, or two columns have one name.
    """
    readers = _readers()
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise EventsError(
            f"{path}: expected a file that ends in {', '.join(readers)}, got "
            f"{path.suffix or 'no ending'!r}."
        )
    if not path.is_file():
        raise EventsError(f"{path}: expected a table of events, but there is no such file.")
    source = reader(path)
    repeated = sorted({name for name in source.names if source.names.count(name) > 1})
    if repeated:
        raise EventsError(
            f"{path}: expected columns of different names, got {repeated[0]!r} "
            f"{source.names.count(repeated[0])} times; rename or remove one."
        )
    return source


def _readers() -> Mapping[str, Callable[[Path], Source]]:
    """Reader of each ending; the libraries behind them load only when a file is opened."""
    from crashrate.events.csv_source import CsvSource
    from crashrate.events.mat_source import MatSource
    from crashrate.events.parquet_source import ParquetSource

    return {".csv": CsvSource, ".parquet": ParquetSource, ".mat": MatSource}


def empty_as_nan(values: Any) -> FloatArray:
    """Arrow's numbers, of any width, as float64 with NaN where a cell is empty."""
    array = np.asarray(values.to_numpy(zero_copy_only=False), dtype=np.float64)
    return array.copy() if not array.flags.writeable else array
