"""The store: everything a run is made of, in one SQLite file that is only ever added to."""

import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from crashrate.errors import StoreError
from crashrate.variables import FloatArray

SCHEMA = "crashrate.run/1"
FILE = "campaign.sqlite"
MOST_NAMED = 5  # run folders in a message
TABLES = """
CREATE TABLE config (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE batches (
    k INTEGER PRIMARY KEY,
    n INTEGER NOT NULL,
    x BLOB NOT NULL,
    outcomes BLOB NOT NULL
);
"""
# of recorded events, beside the campaign: a folder from before this table gets it when it is needed
REPLAYS = "CREATE TABLE IF NOT EXISTS replays (x BLOB PRIMARY KEY, outcome REAL NOT NULL)"
READING = "DEFERRED"  # a transaction that only reads: also of a folder that cannot be written
FLOAT = np.dtype("<f8")  # little-endian on every machine


@dataclass(frozen=True)
class Batch:
    """Situations simulated together, `x` of shape (n, d), and their outcomes of shape (n,).

    With K consequences outcomes are a table (n, 1 + K).
    """

    x: FloatArray
    outcomes: FloatArray


class RunStore:
    """What a run folder remembers: its configuration and every batch of outcomes.

    A batch is written whole or not at all, and nothing is deleted.

    Parameters
    ----------
    directory : Path
        The run folder.
    connection : sqlite3.Connection
        To the folder's SQLite file; see `create` and `open`.
    """

    def __init__(self, directory: Path, connection: sqlite3.Connection) -> None:
        self.directory = directory
        self._connection = connection

    @staticmethod
    def exists(directory: Path) -> bool:
        """Whether `directory` holds a run; a file killed before its first write does not count."""
        path = directory / FILE
        return path.is_file() and path.stat().st_size > 0

    @classmethod
    def create(cls, directory: Path, config: dict[str, str]) -> "RunStore":
        """A new store in `directory`, which is made where it is missing.

        Raises
        ------
        StoreError
            If the folder already holds a run or a result, or cannot be written.
        """
        if cls.exists(directory) or (directory / "result.json").exists():
            raise StoreError(
                f"{directory}: expected a folder without a run, found one; choose another --out."
            )
        make_folder(directory)
        store = cls(directory, _connect(directory, "rwc"))
        with store._transaction() as connection:
            for statement in TABLES.split(";"):
                connection.execute(statement)
            rows = ({"schema": SCHEMA} | config).items()
            connection.executemany("INSERT INTO config VALUES (?, ?)", rows)
        return store

    @classmethod
    def open(cls, directory: Path) -> "RunStore":
        """The store in `directory`.

        Raises
        ------
        StoreError
            If there is none, or it is damaged, or of another schema.
        """
        if not cls.exists(directory):
            raise StoreError(
                f"{directory}: expected a run folder, found {_found_there(directory)}."
            )
        store = cls(directory, _connect(directory, "rw"))
        schema = store.config().get("schema")
        if schema != SCHEMA:
            store.close()
            raise StoreError(
                f"{directory / FILE}: expected the schema {SCHEMA!r}, got {schema!r}; read it with "
                "the crashrate version that wrote it."
            )
        return store

    def config(self) -> dict[str, str]:
        """The configuration, key to text."""
        with self._transaction(READING) as connection:
            rows: list[tuple[str, str]] = connection.execute("SELECT * FROM config").fetchall()
        return dict(rows)

    def set_config(self, key: str, value: str) -> None:
        """Write one text of the configuration."""
        with self._transaction() as connection:
            connection.execute("INSERT OR REPLACE INTO config VALUES (?, ?)", (key, value))

    def n_runs(self) -> int:
        """Number of simulator runs whose outcomes are stored."""
        with self._transaction(READING) as connection:
            (n,) = connection.execute("SELECT COALESCE(SUM(n), 0) FROM batches").fetchone()
        return int(n)

    def seconds_since_stored(self) -> float:
        """How long ago something was last written."""
        return max(time.time() - (self.directory / FILE).stat().st_mtime, 0.0)

    def batches(self, n_variables: int, n_consequences: int = 0) -> list[Batch]:
        """The batches, in the order in which they were asked for.

        Raises
        ------
        StoreError
            If one is missing or its size is not what it says.
        """
        query = "SELECT k, n, x, outcomes FROM batches ORDER BY k"
        with self._transaction(READING) as connection:
            rows = connection.execute(query).fetchall()
        numbers = [row[0] for row in rows]
        if numbers != list(range(len(rows))):
            raise self._damaged(f"batches 0 to {len(rows) - 1}", f"batches {numbers}")
        return [self._batch(row, n_variables, n_consequences) for row in rows]

    def append(self, k: int, batch: Batch) -> None:
        """Write the new batch `k`, whole or not at all.

        Raises
        ------
        StoreError
            If there is a batch `k` already: another process writes to this folder.
        """
        row = (k, len(batch.x), blob(batch.x), blob(batch.outcomes))
        with self._transaction() as connection:
            connection.execute("INSERT INTO batches VALUES (?, ?, ?, ?)", row)

    def extend(self, k: int, batch: Batch) -> None:
        """Write batch `k` again, with more rows after those it has: the budget had cut it short."""
        row = (len(batch.x), blob(batch.x), blob(batch.outcomes), k)
        with self._transaction() as connection:
            connection.execute("UPDATE batches SET n = ?, x = ?, outcomes = ? WHERE k = ?", row)

    def replays(self) -> dict[bytes, float]:
        """Outcomes of the recorded events that were simulated, by the bytes of the situation."""
        with self._transaction() as connection:
            connection.execute(REPLAYS)
            rows = connection.execute("SELECT x, outcome FROM replays").fetchall()
        return dict(rows)

    def add_replays(self, batch: Batch) -> None:
        """Write the outcomes, 0 or 1, of recorded events."""
        rows = [(blob(x), float(y)) for x, y in zip(batch.x, batch.outcomes, strict=True)]
        with self._transaction() as connection:
            connection.executemany("INSERT OR REPLACE INTO replays VALUES (?, ?)", rows)

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @contextmanager
    def _transaction(self, kind: str = "IMMEDIATE") -> Iterator[sqlite3.Connection]:
        try:
            self._connection.execute(f"BEGIN {kind}")
            with self._connection:  # commits, or rolls back on any error
                yield self._connection
        except sqlite3.IntegrityError as error:
            raise StoreError(
                f"{self.directory}: another process writes to this run folder ({error}); wait for "
                "it, or choose another --out."
            ) from error
        except sqlite3.Error as error:
            if getattr(error, "sqlite_errorname", "").startswith("SQLITE_READONLY"):
                raise read_only(self.directory) from error
            raise StoreError(
                f"{self.directory / FILE}: expected a run written by crashrate, got: {error}; "
                "restore the file from a copy, or choose another --out."
            ) from error

    def _batch(self, row: tuple[int, int, bytes, bytes], d: int, n_z: int) -> Batch:
        k, n, x, outcomes = row
        size = FLOAT.itemsize
        if (len(x), len(outcomes)) != (n * d * size, n * (1 + n_z) * size):
            told = f" and {n_z} consequences" if n_z else ""
            expected = f"{n} rows of {d} variables{told} in batch {k}"
            raise self._damaged(expected, f"{len(x)} and {len(outcomes)} bytes")
        table = _array(outcomes)
        return Batch(_array(x).reshape(n, d), table.reshape(n, 1 + n_z) if n_z else table)

    def _damaged(self, expected: str, got: str) -> StoreError:
        return StoreError(
            f"{self.directory / FILE}: damaged: expected {expected}, got {got}; restore the file "
            "from a copy, or choose another --out."
        )


def make_folder(directory: Path) -> bool:
    """Make `directory`; False where it was there.

    Raises
    ------
    StoreError
        If it cannot be made.
    """
    new = not directory.is_dir()
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StoreError(f"{directory}: expected a folder to write to, got: {error}.") from None
    return new


def read_only(directory: Path) -> StoreError:
    """The error of a run folder that cannot be written."""
    return StoreError(
        f"{directory}: this run folder cannot be written (read-only); make it and the files in it "
        "writable, or copy the folder and give the copy as --out."
    )


def _connect(directory: Path, mode: str) -> sqlite3.Connection:
    path = (directory / FILE).resolve()
    try:
        # isolation_level=None: transactions begin where this module says so
        return sqlite3.connect(f"{path.as_uri()}?mode={mode}", uri=True, isolation_level=None)
    except sqlite3.Error as error:
        raise StoreError(f"{path}: expected a file to read and write, got: {error}.") from error


def blob(values: FloatArray) -> bytes:
    """The bytes of an array, the same on every machine."""
    return np.ascontiguousarray(values, dtype=FLOAT).tobytes()


def _array(blob: bytes) -> FloatArray:
    return np.frombuffer(blob, dtype=FLOAT).astype(np.float64)


def _found_there(directory: Path) -> str:
    """What is in the place of a run folder, and what to do."""
    start = "start one with 'crashrate run SCENARIO --traffic … --out DIR'"
    if not directory.is_dir():
        return f"{'a file' if directory.exists() else 'no such folder'}; {start}"
    if below := sorted(str(path.parent) for path in directory.glob(f"*/{FILE}")):
        return f"no {FILE} in it but in {', '.join(below[:MOST_NAMED])}; name one of them"
    return f"no {FILE} in it; {start}"
