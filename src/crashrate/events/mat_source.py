"""MATLAB .mat files of version 5 to 7."""

import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from crashrate.errors import EventsError
from crashrate.events.sources import Column

# what scipy raises on bytes that are not, or no longer, a .mat file
DAMAGED = (
    ArithmeticError,
    AttributeError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
    struct.error,
    zlib.error,
)


@dataclass(frozen=True)
class MatSource:
    """A .mat file: each vector is a column, and so is each vector in a structure of one element.

    A matrix ``m`` of k columns gives the columns ``m_1`` to ``m_k``.

    Notes
    -----
    A file cut short is told. `scipy.io.loadmat` does not check every byte, though, and one with
    overwritten bytes may end the process: read .mat files only from where you trust them.
    """

    path: Path

    @property
    def names(self) -> tuple[str, ...]:
        """The vectors in the file."""
        return tuple(name for name, _ in self._columns)

    def read(self, names: Sequence[str]) -> dict[str, Column]:
        """The columns `names`.

        Raises
        ------
        EventsError
            If one does not hold real numbers, or their lengths differ.
        """
        known = dict(self._columns)
        lengths = {name: len(known[name]) for name in names}
        if len(set(lengths.values())) > 1:
            listed = ", ".join(f"{name} {n}" for name, n in lengths.items())
            raise EventsError(f"{self.path}: expected columns of one length, got {listed}.")
        return {name: self._numbers(name, known[name]) for name in names}

    def _numbers(self, name: str, cells: npt.NDArray[Any]) -> Column:
        if cells.dtype.kind not in "iuf":
            raise EventsError(
                f"{self.path}: column {name!r}: expected real numbers, got type {cells.dtype}."
            )
        single = cells.dtype == np.dtype(np.float32)
        return Column(cells.astype(np.float64), cells, single=bool(single))

    @cached_property
    def _columns(self) -> list[tuple[str, npt.NDArray[Any]]]:
        return list(_vectors(self._load()))

    def _load(self) -> Mapping[str, Any]:
        from scipy.io import loadmat
        from scipy.io.matlab import MatReadError

        try:
            contents: Mapping[str, Any] = loadmat(str(self.path), appendmat=False)
        except NotImplementedError as error:
            raise EventsError(
                f"{self.path}: expected a .mat file of version 5 to 7, got one of version 7.3; "
                "save it in MATLAB with save(..., '-v7')."
            ) from error
        except (MatReadError, *DAMAGED) as error:
            raise EventsError(f"{self.path}: expected a MATLAB .mat file: {error}") from error
        return {name: value for name, value in contents.items() if not name.startswith("__")}


def _vectors(contents: Mapping[str, Any]) -> Iterator[tuple[str, npt.NDArray[Any]]]:
    for name, value in contents.items():
        if not isinstance(value, np.ndarray) or value.ndim != 2:
            continue  # cells, sparse matrices, functions: no columns of numbers
        if value.dtype.names and value.size == 1:
            fields = value.flat[0]
            yield from _vectors({field: fields[field] for field in value.dtype.names})
        elif 1 in value.shape:
            yield name, value.ravel()
        else:
            for k, column in enumerate(value.T):
                yield f"{name}_{k + 1}", column
