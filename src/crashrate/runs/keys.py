"""Checked reading of the tables of a scenario file: what is unknown is refused, never skipped."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from crashrate.errors import ScenarioError
from crashrate.variables import nearest

KINDS = {
    bool: "true or false",
    int: "an integer",
    float: "a number",
    str: "a text",
    dict: "a table",
    list: "a list",
}


@dataclass(frozen=True)
class Table:
    """One table of a scenario file.

    Parameters
    ----------
    values : mapping
        As tomllib read it.
    file : str
        Name of the file, for messages.
    section : str
        Dotted name of the table, empty for the file itself.
    """

    values: Mapping[str, Any]
    file: str
    section: str = ""

    @property
    def where(self) -> str:
        """File and section, as messages begin."""
        return f"{self.file}, [{self.section}]" if self.section else self.file

    def only(self, known: Sequence[str], what: str = "key") -> "Table":
        """The table itself, if it holds no other keys than `known`.

        Raises
        ------
        ScenarioError
            With the nearest known key.
        """
        for key in self.values:
            if key not in known:
                raise self.error(f"unknown {what} {key!r}{nearest(key, known)}")
        return self

    def table(self, key: str) -> "Table":
        """The table under `key`, empty where there is none."""
        section = f"{self.section}.{key}" if self.section else key
        return Table(self._typed(key, dict, {}), self.file, section)

    def text(self, key: str, default: str | None = None) -> str:
        """The text under `key`."""
        value: str = self._typed(key, str, default)
        return value

    def flag(self, key: str, default: bool) -> bool:
        """The true or false under `key`."""
        value: bool = self._typed(key, bool, default)
        return value

    def integer(self, key: str, default: int) -> int:
        """The integer under `key`."""
        value: int = self._typed(key, int, default)
        return value

    def number(self, key: str, default: float) -> float:
        """The number under `key`; an integer will do, NaN will not."""
        value = self._typed(key, float, default)
        if math.isnan(value):
            raise self.error(f"{key}: expected a number, got nan")
        return float(value)

    def numbers(self, key: str, default: Sequence[float]) -> tuple[float, ...]:
        """The list of numbers under `key`."""
        values = self.values.get(key, list(default))
        if not isinstance(values, list) or not all(_is(v, float) for v in values):
            raise self.error(f"{key}: expected a list of numbers, got {values!r}")
        return tuple(float(v) for v in values)

    def texts(self, key: str) -> tuple[str, ...]:
        """The list of texts under `key`, empty where there is none."""
        values = self.values.get(key, [])
        if not isinstance(values, list) or not all(_is(v, str) for v in values):
            raise self.error(f"{key}: expected a list of texts, got {values!r}")
        return tuple(values)

    def optional_number(self, key: str) -> float | None:
        """The number under `key`, None where there is none."""
        return self.number(key, math.inf) if key in self.values else None

    def error(self, message: str) -> ScenarioError:
        """The error that says `message` of this table."""
        return ScenarioError(f"{self.where}: {message}.")

    def _typed(self, key: str, kind: type, default: Any) -> Any:
        if key not in self.values:
            if default is None:
                raise self.error(f"expected {KINDS[kind]} under the key {key!r}, got nothing")
            return default
        value = self.values[key]
        if not _is(value, kind):
            got = KINDS.get(type(value), type(value).__name__)
            raise self.error(f"{key}: expected {KINDS[kind]}, got {value!r} ({got})")
        return value


def _is(value: Any, kind: type) -> bool:
    if isinstance(value, bool):  # which Python counts among the integers
        return kind is bool
    return isinstance(value, (int, float) if kind is float else kind)
