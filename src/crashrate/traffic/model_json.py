"""A traffic model as a JSON document, and back."""

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from crashrate.errors import InvalidInputError
from crashrate.variables import nearest

if TYPE_CHECKING:
    from crashrate.traffic.model import TrafficModel

SCHEMA = "crashrate.traffic-model"
VERSION = 1
_REQUIRED = ("schema", "version", "names", "lower", "upper", "weights", "means", "covariances")
_KNOWN = (*_REQUIRED, "provenance", "scales", "members")
_OWN = ("weights", "means", "covariances", "provenance")  # of a member; it shares the rest


def to_document(model: "TrafficModel") -> dict[str, Any]:
    """The numbers of a model; JSON has no infinity, so an open side is null."""
    # absent where all are linear: what an earlier crashrate wrote stays equal to itself
    members = [{key: own[key] for key in _OWN} for own in (to_document(m) for m in model.members)]
    scales = {} if model.scales.linear else {"scales": [str(s) for s in model.scales.each]}
    return {
        "schema": SCHEMA,
        "version": VERSION,
        "names": list(model.names),
        "lower": [None if math.isinf(v) else v for v in model.lower.tolist()],
        "upper": [None if math.isinf(v) else v for v in model.upper.tolist()],
        "weights": model.weights.tolist(),
        "means": model.means.tolist(),
        "covariances": model.covariances.tolist(),
        **scales,
        "provenance": dict(model.provenance),
        **({"members": members} if members else {}),
    }


def from_document(text_or_path: str | Path) -> dict[str, Any]:
    """Arguments of a traffic model from JSON text or a file of it.

    Raises
    ------
    InvalidInputError
        If there is no such file, or it is not the JSON of a traffic model.
    """
    text, where = _read(text_or_path)
    try:
        document = json.loads(text)
    except json.JSONDecodeError as error:
        raise InvalidInputError(
            f"{where}: expected the JSON of a traffic model, written by 'crashrate fit', got "
            f"something that is not JSON ({error})."
        ) from None
    _check_document(document, where)
    try:
        return _arguments(document)
    except (TypeError, ValueError) as error:
        raise InvalidInputError(f"{where}: expected lists of numbers, got {error}.") from None


def _read(text_or_path: str | Path) -> tuple[str, str]:
    """The text, and what to call its place in an error."""
    if isinstance(text_or_path, str) and text_or_path.lstrip().startswith("{"):
        return text_or_path, "traffic model"
    if not isinstance(text_or_path, (str, Path)):
        raise InvalidInputError(
            f"traffic model: expected JSON text or the path of a file of it, got "
            f"{type(text_or_path).__name__}; json.dumps makes text of a dictionary."
        )
    path = Path(text_or_path)
    try:
        return path.read_text(encoding="utf-8"), str(path)
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidInputError(
            f"traffic model {str(path)!r}: expected a JSON file written by to_json, got {error}."
        ) from None


def _check_document(document: Any, where: str) -> None:
    """Refuse what is not a document of this schema and version, key by key."""
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        got = document.get("schema") if isinstance(document, dict) else type(document).__name__
        raise InvalidInputError(
            f"{where}: expected a traffic model, written by 'crashrate fit', whose schema is "
            f"{SCHEMA!r}, got {got!r}."
        )
    if document.get("version") != VERSION:
        raise InvalidInputError(
            f"{where}: expected version {VERSION}, got {document.get('version')!r}; "
            "fit the model again, or read it with the crashrate that wrote it."
        )
    for key in document:
        if key not in _KNOWN:
            raise InvalidInputError(f"{where}: unknown key {key!r}{nearest(key, _KNOWN)}.")
    missing = [key for key in _REQUIRED if key not in document]
    if missing:
        raise InvalidInputError(f"{where}: expected the keys {', '.join(missing)}, got none.")


def _arguments(document: dict[str, Any]) -> dict[str, Any]:
    """Lists as arrays' contents, null sides as infinities."""
    sides = {"lower": -math.inf, "upper": math.inf}
    arguments: dict[str, Any] = {
        side: [limit if v is None else float(v) for v in document[side]]
        for side, limit in sides.items()
    }
    for key in ("weights", "means", "covariances"):
        arguments[key] = _floats(document[key])
    arguments["names"] = tuple(document["names"])
    arguments["scales"] = document.get("scales")
    arguments["provenance"] = dict(document.get("provenance", {}))
    shared = {key: v for key, v in document.items() if key not in (*_OWN, "members")}
    arguments["members"] = [_arguments(shared | m) for m in document.get("members", [])]
    return arguments


def _floats(value: Any) -> Any:
    """Nested lists with every leaf a float, as deep as they come."""
    return [_floats(v) for v in value] if isinstance(value, list) else float(value)
