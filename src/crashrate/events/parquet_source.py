"""Parquet files."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from crashrate.errors import EventsError
from crashrate.events.sources import Column, empty_as_nan


@dataclass(frozen=True)
class ParquetSource:
    """A Parquet file with one row per event."""

    path: Path

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The columns of the schema."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        try:
            return tuple(pq.read_schema(self.path).names)
        except (pa.ArrowException, OSError, ValueError) as error:
            raise self._unreadable(error) from error

    def read(self, names: Sequence[str]) -> dict[str, Column]:
        """The columns `names`; single precision is widened to double.

        Raises
        ------
        EventsError
            If a column does not hold numbers.
        """
        import pyarrow as pa
        import pyarrow.parquet as pq

        try:
            table = pq.ParquetFile(self.path).read(columns=list(names), use_threads=False)
        except (pa.ArrowException, OSError, ValueError) as error:
            raise self._unreadable(error) from error
        return {name: self._numbers(name, table[name]) for name in names}

    def _numbers(self, name: str, cells: Any) -> Column:
        import pyarrow as pa
        import pyarrow.compute as pc

        kind = cells.type
        if not (pa.types.is_integer(kind) or pa.types.is_floating(kind)):
            raise EventsError(f"{self.path}: column {name!r}: expected numbers, got type {kind}.")
        numbers = pc.cast(cells, pa.float64(), safe=False)
        return Column(empty_as_nan(numbers), cells, single=kind == pa.float32())

    def _unreadable(self, error: Exception) -> EventsError:
        return EventsError(f"{self.path}: expected a Parquet file: {error}")
