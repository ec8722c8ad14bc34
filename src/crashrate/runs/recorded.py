"""The events behind a traffic model, kept in a file beside it: to replay, and to check its tail."""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from crashrate.errors import InvalidInputError, StoreError
from crashrate.events import EventTable
from crashrate.runs.looked_at import unchecked_by
from crashrate.traffic.model import TrafficModel

ENDING = ".events.parquet"
META = b"crashrate.events"
ROW = "source_row"


def events_path(traffic: Path) -> Path:
    """Where the events of the traffic model in file `traffic` lie."""
    return traffic.with_suffix(ENDING)


def digest(events: EventTable) -> str:
    """What tells one set of events from another: SHA-256 of their values."""
    return hashlib.sha256(np.ascontiguousarray(events.values).tobytes()).hexdigest()


def require_replaceable_events(traffic: Path, source: Path) -> None:
    """Refuse to write events over a file that is no copy of this kind, or is being read.

    Raises
    ------
    StoreError
        Naming the file.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = events_path(traffic)
    if not path.exists():
        return
    try:
        known = META in (pq.read_schema(path).metadata or {})
    except (OSError, pa.ArrowException):
        known = False
    if not known or path.resolve() == source.resolve():
        raise StoreError(
            f"{path}: a copy of the events is written here, beside {traffic.name}, but there is a "
            "file of yours already; it is kept as it is. Choose another --out."
        )


def write_events(traffic: Path, events: EventTable) -> Path:
    """Write the events beside the traffic model in file `traffic`, the old or the new whole."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = dict(zip(events.names, events.values.T, strict=True))
    meta = json.dumps({"source": events.source, "dropped": dict(events.dropped)})
    table = pa.table({**columns, ROW: events.rows}).replace_schema_metadata({META: meta})
    path = events_path(traffic)
    temporary = path.with_name(f"{path.name}.new")
    pq.write_table(table, temporary)
    temporary.replace(path)
    return path


def events_for(traffic: str, model: TrafficModel, method: str) -> tuple[EventTable | None, str]:
    """The events behind the model in file `traffic`, for a run by `method`; or why there are none.

    Raises
    ------
    InvalidInputError
        As `read_events_beside`.
    """
    if not _known(model):
        return None, "it comes without events"
    if unchecked := unchecked_by(method):
        return None, unchecked
    events = read_events_beside(Path(traffic), model)
    missing = f"there is no {events_path(Path(traffic))}, which 'crashrate fit' writes"
    return events, "" if events else missing


def read_events_beside(traffic: Path, model: TrafficModel) -> EventTable | None:
    """The events that `model`, read from file `traffic`, was fitted to; None where they are gone.

    Raises
    ------
    InvalidInputError
        If the file beside it holds other events, or is damaged.
    """
    path, known = events_path(traffic), _known(model)
    if not known or not path.is_file():
        return None
    events = _read(path, model.names)
    if digest(events) != known:
        raise InvalidInputError(
            f"{path}: expected the events that {traffic.name} was fitted to, got others; fit the "
            "model again, or move this file away to go on without them."
        )
    return events


def _known(model: TrafficModel) -> str:
    """The digest of the events that the model was fitted to; empty where it has none."""
    events: dict[str, Any] = model.provenance.get("events") or {}
    return str(events.get("sha256") or "")


def _read(path: Path, names: tuple[str, ...]) -> EventTable:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(path)
        meta = json.loads((table.schema.metadata or {})[META])
        values = np.stack([table[name].to_numpy() for name in names], axis=1)
        rows = table[ROW].to_numpy()
    except (OSError, KeyError, ValueError, pa.ArrowException) as error:
        raise InvalidInputError(
            f"{path}: expected the copy of the events that 'crashrate fit' wrote, got: {error!r}; "
            "fit the model again, or move this file away to go on without it."
        ) from error
    return EventTable(names, values, str(meta["source"]), rows, dict(meta["dropped"]))
