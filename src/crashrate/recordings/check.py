"""All that the recordings say about an answer, together: computed once a campaign has learned."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np

from crashrate.errors import CrashrateError
from crashrate.estimation.alarms import Alarm
from crashrate.estimation.estimate import Estimate
from crashrate.recordings.comparison import Comparison
from crashrate.recordings.expectation import Draws
from crashrate.recordings.extremes import Extremes, extremes
from crashrate.recordings.influential import Influential, influential
from crashrate.recordings.ladder import Ladder, ladder
from crashrate.recordings.near_misses import Quantity, Tail, expected_beyond, tails
from crashrate.recordings.replay import Replay
from crashrate.recordings.rivals import Rival, rival
from crashrate.traffic.alternatives import alternatives
from crashrate.variables import FloatArray

DRAWS_PER_EVENT, MAX_DRAWS = 10, 1_000_000
Say = Callable[[str], None]
Part = TypeVar("Part")


@dataclass(frozen=True, eq=False)
class Check:
    """What the recordings say.

    Parameters
    ----------
    replay : Replay
    ladder : Ladder or None
        None where no severity is declared.
    extremes : Extremes or None
        None where too few events come near a crash, or too many crash.
    tails : tuple of Tail
    influential : Influential or None
        None where the model expects no crash in what the campaign learned.
    rivals : tuple of Rival
        Other laws of traffic, for comparison.
    n_duplicates : int
        Recorded events that equal an earlier one in every digit.
    failed : mapping
        Parts that could not be computed, to why.
    """

    replay: Replay
    ladder: Ladder | None
    extremes: Extremes | None
    tails: tuple[Tail, ...]
    influential: Influential | None
    rivals: tuple[Rival, ...]
    n_duplicates: int
    failed: Mapping[str, str] = field(default_factory=dict)

    def alarms(self, estimate: Estimate) -> tuple[Alarm, ...]:
        """Doubts that the recordings cast on the estimate."""
        claimed, moved = self._claimed(estimate), self._moved(estimate)
        # without an order what was learned is not to be trusted where events are made worse
        ordered = not {Alarm.NO_ORDER, Alarm.ORDER_DROPPED} & set(estimate.alarms)
        raised = {
            Alarm.TAIL_MISFIT: self.ladder is not None and self.ladder.misfit,
            Alarm.EXTREMES_DISAGREE: (
                ordered
                and self.extremes is not None
                and _apart(self.extremes.alarm_interval, claimed)
            ),
            Alarm.NEAR_MISSES_DISAGREE: any(tail.misfit for tail in self.tails),
            Alarm.TRAFFIC_UNDETERMINED: moved is not None and moved.open_wide,
            Alarm.REPLAY_DISAGREES: _apart(self.replay.interval, claimed),
            Alarm.FEW_EVENTS_DECIDE: moved is not None and moved.few,
        }
        return tuple(alarm for alarm, is_raised in raised.items() if is_raised)

    def _claimed(self, estimate: Estimate) -> tuple[float, float]:
        """The least and the largest probability that answer, fits and learned set allow."""
        found = estimate.traffic_range
        allowed = [*estimate.interval, *(() if found is None else found.quantiles)]
        if self.ladder is not None:
            allowed.append(self.ladder.expected[0] / self.replay.n_events)
        known = [value for value in allowed if math.isfinite(value)]
        return min(known), max(known)

    def sentences(self, estimate: Estimate) -> list[str]:
        """What to read below the answer: the replay, and what few events decide."""
        said = estimate.traffic_range is not None and estimate.traffic_range.undetermined
        spoken = [self.replay.sentence()]
        if (moved := self._moved(estimate)) is not None:
            spoken += moved.sentences(self.replay.n_events, said=said)
        return spoken

    def _moved(self, estimate: Estimate) -> Influential | None:
        """What the events move; nothing where there is no number yet that they could."""
        return self.influential if estimate.probability > 0 else None

    def to_dict(self) -> dict[str, Any]:
        """As JSON-ready values."""
        return {
            "replay": self.replay.to_dict(),
            "severity_ladder": self.ladder and self.ladder.to_dict(),
            "extremes": self.extremes and self.extremes.to_dict(),
            "tails": [tail.to_dict() for tail in self.tails],
            "influence": self.influential and self.influential.to_dict(),
            "alternatives": [r.to_dict() for r in self.rivals],
            "n_duplicates": self.n_duplicates,
            "failed": dict(self.failed),
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "Check":
        """What `to_dict` wrote."""
        steps, tail, own = (values[k] for k in ("severity_ladder", "extremes", "influence"))
        return cls(
            Replay.from_dict(values["replay"]),
            Ladder.from_dict(steps) if steps else None,
            Extremes.from_dict(tail) if tail else None,
            tuple(Tail.from_dict(v) for v in values["tails"]),
            Influential.from_dict(own) if own else None,
            tuple(Rival.from_dict(v) for v in values["alternatives"]),
            int(values["n_duplicates"]),
            dict(values["failed"]),
        )


def _apart(a: tuple[float, float], b: tuple[float, float]) -> bool:
    return a[1] < b[0] or b[1] < a[0]


class _Parts:
    """Computes part after part: one that fails takes no other with it, and says why."""

    def __init__(self, say: Say) -> None:
        self._say = say
        self.failed: dict[str, str] = {}

    def get(self, name: str, compute: Callable[[], Part]) -> Part | None:
        """The part, or None where it cannot be computed."""
        self._say(f"checking the recordings: {name}")
        try:
            return compute()
        # of the last kind are numpy's linear algebra, and scipy's complaints of data
        except (CrashrateError, ArithmeticError, ValueError) as error:
            self.failed[name] = str(error)
            return None


def check(
    c: Comparison, quantities: Sequence[Quantity], replay: Replay, say: Say = lambda _: None
) -> Check:
    """Compare the recordings with the traffic model where crashes come from; no simulator runs.

    Parameters
    ----------
    c : Comparison
    quantities : sequence of Quantity
        Whose dangerous tails are compared.
    replay : Replay
        What replaying the events gave.
    say : callable
        Told what is being done.
    """
    parts, model = _Parts(say), c.traffic.modelled
    draws = parts.get("crashes of the model", lambda: c.draws(model.average, 0))
    steps = moved = None
    if draws is not None:
        ratios = model.member_ratios(draws.x) if model.members else np.ones((len(draws.x), 1))
        steps = parts.get("severity ladder", lambda: _ladder(c, draws, ratios))
        moved = parts.get("influence", lambda: _influential(c, draws, ratios[:, 0]))
    near = parts.get("near misses", lambda: tails(quantities, c.events.values, _ordinary(c)))
    margins = parts.get("extreme values", lambda: _extremes(c))
    rivals = parts.get("other laws of traffic", lambda: _rivals(c, quantities, near or ()))
    duplicates = n_duplicates(c.events.values)
    return Check(replay, steps, margins, near or (), moved, rivals or (), duplicates, parts.failed)


def _ladder(c: Comparison, draws: Draws, ratios: FloatArray) -> Ladder | None:
    if c.severity is None:
        return None
    members = draws.under(ratios) if c.traffic.members else None
    return ladder(c.levels, c.first, draws, c.rng(2), members)


def _ordinary(c: Comparison) -> FloatArray:
    """Draws of the traffic model, at best ten for each event."""
    n = min(DRAWS_PER_EVENT * len(c.events), MAX_DRAWS)
    return c.traffic.average.sample(n, c.rng(1))


def _influential(c: Comparison, draws: Draws, ratios: FloatArray) -> Influential | None:
    """Under the best fit, whose density over the average's is `ratios` (n,) at the draws."""
    crash = draws.index == 0
    weights = draws.weights[crash] * ratios[crash]
    if not weights.sum() > 0:
        return None
    best = replace(c.traffic.modelled, members=())
    return influential(best, c.events, c.z, draws.x[crash], weights)


def _extremes(c: Comparison) -> Extremes | None:
    """By the severity factors, up to the ladder's last, at which events begin to crash."""
    if c.severity is None:
        return None
    worst = c.events.values[c.first < len(c.levels)]
    critical = c.severity.critical_factors(worst, c.crashes, c.levels[-1])
    return extremes(np.log(critical), len(c.events), c.confidence)


def _rivals(
    c: Comparison, quantities: Sequence[Quantity], near: Sequence[Tail]
) -> tuple[Rival, ...]:
    def count(x: FloatArray) -> tuple[tuple[float, ...], ...]:
        return expected_beyond(quantities, near, x, len(c.events))

    laws = alternatives(c.z, c.traffic.modelled.lower, c.traffic.modelled.upper)
    return tuple(rival(c, law, count, 10 * (1 + k)) for k, law in enumerate(laws))


def n_duplicates(x: FloatArray) -> int:
    """Rows of x (n, d) that equal an earlier one."""
    return len(x) - len(np.unique(x, axis=0))
