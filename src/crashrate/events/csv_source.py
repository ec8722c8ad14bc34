"""CSV files: a header line with the columns' names, then one row per event."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from crashrate.errors import EventsError
from crashrate.events.sources import Column, empty_as_nan

OTHER_SEPARATORS = {";": "semicolons", "\t": "tabs"}
MAX_HEADER = 65536  # bytes looked at for a hint
NUMBER = r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$"


@dataclass(frozen=True)
class CsvSource:
    """A CSV file, comma-separated, in UTF-8.

    Cells are read as text and turned into numbers here: a column that starts with numbers and has
    text in its millionth row is told by that row, not by a guessed type.
    """

    path: Path

    @property
    def names(self) -> tuple[str, ...]:
        """The header, without the blanks that may follow its commas."""
        return tuple(name.strip() for name in self._header)

    @cached_property
    def _header(self) -> tuple[str, ...]:
        import pyarrow as pa
        from pyarrow import csv

        try:
            with csv.open_csv(self.path, read_options=csv.ReadOptions(use_threads=False)) as file:
                header = tuple(file.schema.names)
        except (pa.ArrowException, OSError, ValueError) as error:
            raise self._unreadable(error) from error
        if len(header) == 1 and _other_separator(header[0]):
            raise self._unreadable("one column", header[0])
        return header

    def read(self, names: Sequence[str]) -> dict[str, Column]:
        """The columns `names`; a cell that is not a number becomes NaN."""
        import pyarrow as pa
        from pyarrow import csv

        written = {name: self._header[self.names.index(name)] for name in names}
        wanted = csv.ConvertOptions(
            include_columns=list(written.values()),
            column_types=dict.fromkeys(written.values(), pa.string()),
        )
        options = csv.ReadOptions(use_threads=False)  # errors then name the row
        try:
            table = csv.read_csv(self.path, read_options=options, convert_options=wanted)
        except (pa.ArrowException, OSError, ValueError) as error:
            raise self._unreadable(error) from error
        return {name: _numbers(table[in_file]) for name, in_file in written.items()}

    def _unreadable(self, error: object, first_line: str = "") -> EventsError:
        other = _other_separator(first_line or self._first_line())
        hint = f" Its columns are separated by {other}: save it again with commas." if other else ""
        return EventsError(
            f"{self.path}: expected a comma-separated table in UTF-8 with a header line: "
            f"{str(error).rstrip('.')}.{hint}"
        )

    def _first_line(self) -> str:
        try:
            with self.path.open("rb") as file:
                return file.readline(MAX_HEADER).decode("utf-8", errors="replace")
        except OSError:
            return ""


def _other_separator(header: str) -> str:
    """What stands between the columns' names where no comma does, in words; else empty."""
    found = [words for mark, words in OTHER_SEPARATORS.items() if mark in header]
    return found[0] if found and "," not in header else ""


def _numbers(cells: Any) -> Column:
    import pyarrow as pa
    import pyarrow.compute as pc

    text = pc.utf8_trim_whitespace(cells)
    try:
        numbers = pc.cast(text, pa.float64())
    except pa.ArrowInvalid:  # some cell is no number: leave those empty, the caller names them
        clean = pc.if_else(pc.match_substring_regex(text, NUMBER), text, None)
        numbers = pc.cast(clean, pa.float64())
    return Column(empty_as_nan(numbers), text)
