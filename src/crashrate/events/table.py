"""A table of events: one recorded encounter per row."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from crashrate.variables import FloatArray, frozen


@dataclass(frozen=True, eq=False)
class EventTable:
    """Recorded events in the traffic model's variables.

    Parameters
    ----------
    names : tuple of str
        The variables, in order.
    values : array (n, d)
    source : str
        The file that the events come from.
    rows : int array (n,)
        Where each event was in the file, counted from 0 (messages count from 1).
    dropped : mapping
        Why rows were dropped, to how many.
    n_on_bound : int
        Single-precision values that equal a bound up to their own rounding, and lie on it now.
    """

    names: tuple[str, ...]
    values: FloatArray
    source: str
    rows: npt.NDArray[np.int64]
    dropped: Mapping[str, int] = field(default_factory=dict)
    n_on_bound: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", frozen(self.values))
        object.__setattr__(self, "rows", frozen(self.rows, np.int64))
        object.__setattr__(self, "dropped", dict(self.dropped))

    def __len__(self) -> int:
        return len(self.values)

    @property
    def n_read(self) -> int:
        """Number of rows in the file."""
        return len(self) + sum(self.dropped.values())

    def summary(self) -> str:
        """What was read, and how many rows were dropped and why, in one sentence."""
        kept = f"{self.source}: {len(self):,} events"
        if not self.dropped:
            return f"{kept}, no row dropped"
        reasons = ", ".join(f"{n:,} {reason}" for reason, n in self.dropped.items())
        return f"{kept} of {self.n_read:,} rows; dropped: {reasons}"
