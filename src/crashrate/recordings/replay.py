"""Replay: the recorded events themselves as a crude Monte Carlo run, few of them simulated.

Nearly all recorded events are so harmless that what the campaign learned settles them; the others
are simulated, the most dangerous first.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import betaincinv

from crashrate.variables import BoolArray, FloatArray

DOUBT = 1e-3  # an event that crashes with less than this, as learned, counts as safe ...
LEAST = 10  # ... but so many of the most dangerous are simulated in any case: an audit

IntArray = np.ndarray


@dataclass(frozen=True)
class Replay:
    """What the recorded events say alone.

    Parameters
    ----------
    n_events : int
    n_simulated : int
        Simulator runs; equal events share one, and what was learned settles the others.
    n_crashes : int
        Events that crashed in them.
    n_open : int
        Events in doubt that were not simulated (the budget ended), or whose simulation failed.
    expected_open : float
        Crashes among those, by what was learned.
    n_failed : int
        Events in doubt because their simulation failed.
    ordered : bool
        Whether a risk order helped to settle the others, or a surrogate alone.
    crashing : tuple of int
        Rows of the crashing events in their file, counted from 1.
    confidence : float
    """

    n_events: int
    n_simulated: int
    n_crashes: int
    n_open: int
    crashing: tuple[int, ...]
    expected_open: float = 0.0
    n_failed: int = 0
    ordered: bool = True
    confidence: float = 0.95

    @property
    def probability(self) -> float:
        """Share of the events that crash, those in doubt counted by what was learned."""
        return (self.n_crashes + self.expected_open) / self.n_events

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
        low, high = (_short(v) for v in self.interval)
        crashes = f"{self.n_crashes} crash{'' if self.n_crashes == 1 else 'es'}"
        about = "about " if self.n_open else ""
        text = (
            f"replay: the {self.n_events:,} events themselves give "
            f"{about}{_short(self.probability)} [{low}, {high}] "
            f"({crashes}; {self.n_simulated} simulated"
        )
        if self.n_open:
            failed = f" ({self.n_failed} failed)" if self.n_failed else ""
            text += (
                f"; {self.n_open:,} in doubt{failed}, which the lower end takes for safe and the "
                "upper for crashes"
            )
        return text + ("" if self.ordered else "; the others by the surrogate alone") + ")"

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


def to_simulate(
    h: FloatArray, surrogate_h: FloatArray, max_runs: int, *, ordered: bool
) -> IntArray:
    """Indices of the situations to simulate: in doubt, and a few more, most dangerous first.

    All that the budget allows where no order is in use: a surrogate alone misses crashes.
    """
    wanted = max(int(np.count_nonzero(h > DOUBT)), LEAST) if ordered else max_runs
    return np.lexsort((-surrogate_h, -h))[: min(wanted, max_runs)]


def replayed(
    h: FloatArray,
    outcomes: FloatArray,
    rows: IntArray,
    *,
    failed: BoolArray,
    n_runs: int,
    confidence: float,
    ordered: bool = True,
) -> Replay:
    """The replay of n events.

    Parameters
    ----------
    h : ndarray (n,)
        Probability that each event crashes, as learned.
    outcomes : ndarray (n,)
        1 or 0 where an event was simulated, else NaN.
    rows : int array (n,)
        Of the events in their file, counted from 0.
    failed : bool array (n,)
        Events whose simulation failed: in doubt, whatever was learned.
    n_runs : int
        Simulator runs behind the outcomes.
    confidence : float
    ordered : bool
        As of `Replay`.
    """
    left = np.isnan(outcomes) & ((h > DOUBT) | failed)
    crashing = np.flatnonzero(outcomes == 1)
    return Replay(
        len(h),
        n_runs,
        len(crashing),
        int(np.count_nonzero(left)),
        tuple(int(row) + 1 for row in np.sort(rows[crashing])),
        float(h[left].sum()),
        int(np.count_nonzero(failed & left)),
        ordered,
        confidence,
    )
