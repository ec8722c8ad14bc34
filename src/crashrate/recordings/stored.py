"""Frozen values as JSON holds them: tuples are lists there."""

from collections.abc import Mapping
from typing import Any


def as_stored(value: object) -> dict[str, Any]:
    """The fields of a frozen value, tuples as lists."""
    return {k: list(v) if isinstance(v, tuple) else v for k, v in vars(value).items()}


def as_fields(values: Mapping[str, Any]) -> dict[str, Any]:
    """What `as_stored` made, as the fields of a frozen value."""
    return {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
