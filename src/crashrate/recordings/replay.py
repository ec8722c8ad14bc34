"""Replay: the recorded events themselves as a crude Monte Carlo run, few of them simulated.

Nearly all recorded events are so harmless that what the campaign learned settles them; the others
are simulated, the most dangerous first.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import betaincinv

from crashrate.variables import FloatArray

DOUBT = 1e-3  # an event that crashes with less than this, as learned, counts as safe ...
LEAST = 10  # ... but so many of the most dangerous are simulated in any case: an audit


@dataclass(frozen=True)
class Replay:
    """What the recorded events say alone.

    Parameters
    ----------
    n_events : int
    n_simulated : int
        Of them; what was learned settles the others.
    n_crashes : int
        Simulated events that crashed.
    n_open : int
        Events in doubt that were not simulated (the budget ended), or whose simulation failed.
    crashing : tuple of int
        Rows of the crashing events in their file, counted from 1.
    confidence : float
    """

    n_events: int
    n_simulated: int
    n_crashes: int
    n_open: int
    crashing: tuple[int, ...]
    confidence: float = 0.95

    @property
    def probability(self) -> float:
        """Share of the events that crash, those in doubt left out."""
        return self.n_crashes / self.n_events

    @property
    def interval(self) -> tuple[float, float]:
        """Clopper & Pearson (1934); the upper end counts every event in doubt as a crash."""
        n, low, high = self.n_events, self.n_crashes, self.n_crashes + self.n_open
        tail = (1 - self.confidence) / 2
        return (
            float(betaincinv(low, n - low + 1, tail)) if low else 0.0,
            float(betaincinv(high + 1, n - high, 1 - tail)) if high < n else 1.0,
        )

    def sentence(self) -> str:
        """The replay in one sentence."""
        low, high = self.interval
        crashes = f"{self.n_crashes} crash{'' if self.n_crashes == 1 else 'es'}"
        text = (
            f"replay: the {self.n_events:,} events themselves give {_short(self.probability)} "
            f"[{_short(low)}, {_short(high)}] ({crashes}; {self.n_simulated} simulated"
        )
        if self.n_open:
            text += f", {self.n_open} in doubt that the upper end counts as crashes"
        return text + ")"

    def to_dict(self) -> dict[str, Any]:
        """As JSON-ready values."""
        return {**vars(self), "crashing": list(self.crashing)} | {
            "probability": self.probability,
            "interval": list(self.interval),
            "sentence": self.sentence(),
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "Replay":
        """What `to_dict` wrote."""
        own = {name: values[name] for name in cls.__dataclass_fields__}
        return cls(**{**own, "crashing": tuple(own["crashing"])})


def _short(value: float) -> str:
    return f"{value:.1e}" if value else "0"


def to_simulate(h: FloatArray, max_runs: int) -> np.ndarray:
    """Indices of the events to simulate: those in doubt and a few more, most dangerous first."""
    wanted = max(int(np.count_nonzero(h > DOUBT)), LEAST)
    return np.argsort(-h, kind="stable")[: min(wanted, max_runs)]


def replayed(
    h: FloatArray, simulated: np.ndarray, outcomes: FloatArray, rows: np.ndarray, confidence: float
) -> Replay:
    """The replay in which the events `simulated` had `outcomes` (1, 0, or NaN for failed)."""
    doubt = h > DOUBT
    doubt[simulated] = np.isnan(outcomes)
    crashing = simulated[outcomes == 1]
    return Replay(
        len(h),
        len(simulated),
        len(crashing),
        int(np.count_nonzero(doubt)),
        tuple(int(row) + 1 for row in np.sort(rows[crashing])),
        confidence,
    )
