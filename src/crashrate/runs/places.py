"""Places to write to, and files to read, checked before any work that would be lost."""

import os
from pathlib import Path

from crashrate import datasets
from crashrate.errors import InvalidInputError, StoreError
from crashrate.runs.result import REPORT, RESULT
from crashrate.runs.store import RunStore
from crashrate.traffic.model import TrafficModel
from crashrate.traffic.model_json import from_document

PUBLISHED = "published"
EVENTS_ENDINGS = (".csv", ".parquet", ".mat")


def require_file_place(path: Path) -> None:
    """Refuse a file that could not be written; its folder may be missing still.

    Raises
    ------
    StoreError
        Saying what is in the way.
    """
    if path.is_dir():
        raise StoreError(f"{path}: expected a file to write, found a folder; give a file's name.")
    if path.exists() and not os.access(path, os.W_OK):
        raise StoreError(f"{path}: this file cannot be written (no permission, or read-only).")
    require_folder_place(path.parent)


def require_replaceable(path: Path) -> None:
    """Refuse to write a traffic model over a file that is none.

    Raises
    ------
    StoreError
        Naming the file.
    """
    if not path.exists():
        return
    try:
        from_document(path)
    except InvalidInputError:
        raise StoreError(
            f"{path}: expected a new file, or a traffic model to replace; this file is something "
            "else and is kept as it is. Choose another --out."
        ) from None


def require_folder_place(path: Path) -> None:
    """Refuse a folder that could not be written to, or not be made.

    Raises
    ------
    StoreError
        Saying what is in the way.
    """
    there = path.absolute()
    while not there.exists():
        there = there.parent
    if not there.is_dir():
        raise StoreError(f"{path}: expected a folder, but {there} is a file; choose another --out.")
    if not os.access(there, os.W_OK | os.X_OK):
        raise StoreError(
            f"{path}: {there} cannot be written to (no permission, or read-only); choose another "
            "--out."
        )


def require_run_place(path: Path) -> None:
    """Refuse a folder for a run whose files would be written over others of their names.

    Raises
    ------
    StoreError
        Saying what is in the way.
    """
    require_folder_place(path)
    if RunStore.exists(path):
        return
    for name in (RESULT, REPORT):
        if (path / name).exists():
            raise StoreError(
                f"{path}: holds a {name}, but no run that it is of; a run would write over it. "
                "Move it away, or choose another --out."
            )


def traffic_named(text: str) -> TrafficModel:
    """The traffic model that ``published`` or the name of a file stands for.

    Raises
    ------
    InvalidInputError
        If there is no such file, or it is not a traffic model: naming the file.
    """
    if text == PUBLISHED:
        return datasets.spmd_mixture()
    path = Path(text)
    if not path.is_file():
        what = "is a folder" if path.is_dir() else "no such file"
        raise InvalidInputError(
            f"--traffic {text}: {what}; give '{PUBLISHED}', or a file written by 'crashrate fit'."
        )
    if path.suffix.lower() in EVENTS_ENDINGS:
        raise InvalidInputError(
            f"--traffic {text}: a table of events, no traffic model; fit one with 'crashrate fit "
            f"{text} --scenario SCENARIO --out traffic.json'."
        )
    try:
        return TrafficModel.from_json(path)
    except InvalidInputError as error:
        if str(error).startswith(text):
            raise
        raise InvalidInputError(f"{text}: {error}") from error
