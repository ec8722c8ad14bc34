"""Near misses: how often recorded events come close, against what the traffic model expects."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import nbinom

from crashrate.recordings.stored import as_fields, as_stored
from crashrate.variables import FloatArray

RANKS = (10, 100, 1000)
N_POINTS = 60  # of the quantile plot
CONFIDENCE = 0.95
ALARM_CONFIDENCE, MIN_OUTSIDE = 0.99, 2  # at so many levels of one quantity


@dataclass(frozen=True)
class Quantity:
    """Something that says how near an event is to a crash.

    Parameters
    ----------
    name, unit : str
    of : callable
        Situations x (n, d) to values (n,).
    sign : float
        +1 where a larger value is more dangerous, else -1.
    """

    name: str
    unit: str
    of: Callable[[FloatArray], FloatArray]
    sign: float


@dataclass(frozen=True)
class Tail:
    """The dangerous tail of one quantity, in recordings and model.

    Parameters
    ----------
    name, unit : str
    sign : float
        +1 where larger is more dangerous.
    counts : tuple of int
        Recorded events at least as dangerous as a level.
    levels : tuple of float
        Of about the 10th, 100th and 1000th most dangerous event.
    expected : tuple of float
        Events beyond it that the model expects among as many.
    low, high : tuple of float
        Where the expected number lies in 95 % of recordings, if the model is right.
    observed_quantiles, model_quantiles : tuple of float
        The most dangerous recorded values, and the model's at the same share of events.
    misfit : bool
        Whether the model misses this tail: outside at two levels, at 99 %. There are several
        quantities of three levels each, and at 95 % at one of them any model is now and then.
    """

    name: str
    unit: str
    sign: float
    counts: tuple[int, ...]
    levels: tuple[float, ...]
    expected: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    observed_quantiles: tuple[float, ...]
    model_quantiles: tuple[float, ...]
    misfit: bool = False

    @property
    def outside(self) -> tuple[bool, ...]:
        """At each level, whether the expected number is outside of `low` to `high`."""
        return _outside(self.low, self.expected, self.high)

    def to_dict(self) -> dict[str, Any]:
        """As JSON-ready values."""
        return as_stored(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "Tail":
        """What `to_dict` wrote."""
        return cls(**as_fields(values))


def tail_of(quantity: Quantity, events: FloatArray, draws: FloatArray) -> Tail:
    """Compare the dangerous tails of recorded events x (n, d) and of a model's draws (m, d)."""
    return _compared(quantity, _falling(quantity, events), _falling(quantity, draws))


def _compared(quantity: Quantity, seen: FloatArray, drawn: FloatArray) -> Tail:
    """The tails of events' and draws' values, each with the most dangerous first."""
    levels = np.unique([seen[rank - 1] for rank in RANKS if rank <= len(seen) // 10])[::-1]
    counts = _beyond(seen, levels)  # as many as the rank, and more where values are rounded
    # half-way to the next recorded value: rounded ones stand for as much on either side
    edges = np.array([(seen[n - 1] + seen[min(n, len(seen) - 1)]) / 2 for n in counts])
    every = len(seen) / len(drawn)
    expected = tuple(b * every for b in _beyond(drawn, edges))
    low, high = _limits(counts, every, CONFIDENCE)
    least, most = _limits(counts, every, ALARM_CONFIDENCE)
    return Tail(
        quantity.name,
        quantity.unit,
        quantity.sign,
        tuple(counts),
        tuple(quantity.sign * float(level) for level in levels),
        expected,
        low,
        high,
        *_quantiles(quantity.sign, seen, drawn),
        misfit=sum(_outside(least, expected, most)) >= MIN_OUTSIDE,
    )


def _limits(
    counts: Sequence[int], every: float, confidence: float
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Where the number that the model expects lies for so many events, if the model is right.

    Beyond the event of rank r the model expects a Gamma(r) number, of which draws, one for `every`
    events, see a Poisson one: negative binomial together.
    """
    low, high = (
        tuple(float(nbinom.ppf(q, count, every / (1 + every))) * every for count in counts)
        for q in ((1 - confidence) / 2, (1 + confidence) / 2)
    )
    return low, high


def _outside(
    low: Sequence[float], values: Sequence[float], high: Sequence[float]
) -> tuple[bool, ...]:
    return tuple(not a <= v <= b for a, v, b in zip(low, values, high, strict=True))


def _beyond(falling: FloatArray, levels: FloatArray) -> list[int]:
    """How many of the values, largest first, reach each level."""
    return [int(np.searchsorted(-falling, -level, side="right")) for level in levels]


def _quantiles(
    sign: float, seen: FloatArray, drawn: FloatArray
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """The observed values at log-spaced ranks, and the model's at the same shares."""
    n = len(seen)
    top = max(min(1000, n // 10), 1)
    ranks = np.unique(np.geomspace(1, top, N_POINTS).round().astype(int))
    there = np.minimum((ranks - 0.5) / n * len(drawn), len(drawn) - 1).astype(int)
    return tuple((sign * seen[ranks - 1]).tolist()), tuple((sign * drawn[there]).tolist())


def expected_beyond(
    quantities: Sequence[Quantity], found: Sequence[Tail], draws: FloatArray, n_events: int
) -> tuple[tuple[float, ...], ...]:
    """Events beyond the levels of tails that another law expects, by its draws (m, d)."""
    by_name = {q.name: q for q in quantities}
    every = n_events / len(draws)
    return tuple(
        tuple(every * b for b in _beyond(_falling(by_name[t.name], draws), _signed(t)))
        for t in found
    )


def _falling(quantity: Quantity, x: FloatArray) -> FloatArray:
    """Values, the most dangerous first, larger ones more dangerous."""
    return np.sort(quantity.sign * quantity.of(x))[::-1]


def _signed(tail: Tail) -> FloatArray:
    return tail.sign * np.array(tail.levels)


def tails(
    quantities: Sequence[Quantity], events: FloatArray, draws: FloatArray
) -> tuple[Tail, ...]:
    """The tails of all quantities, those that do not vary left out."""
    # once: a quantity may be a simulation of every event
    seen = [(q, _falling(q, events)) for q in quantities]
    return tuple(_compared(q, v, _falling(q, draws)) for q, v in seen if v[0] > v[-1])
