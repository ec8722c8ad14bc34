"""All that the recordings say about an answer, together: computed once a campaign has learned."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from crashrate.estimation.alarms import Alarm
from crashrate.estimation.estimate import Estimate
from crashrate.recordings.comparison import Comparison
from crashrate.recordings.expectation import Draws
from crashrate.recordings.extremes import N_EXCEEDANCES, Extremes, extremes
from crashrate.recordings.influential import Influential, influential
from crashrate.recordings.ladder import Ladder, ladder
from crashrate.recordings.near_misses import Quantity, Tail, tails
from crashrate.recordings.replay import Replay
from crashrate.recordings.rivals import Rival, rival
from crashrate.traffic.alternatives import alternatives
from crashrate.variables import FloatArray

DRAWS_PER_EVENT, MAX_DRAWS = 10, 1_000_000
FACTOR_STEP, MAX_FACTOR, MIN_FACTOR = 1.25, 10.0, 0.2
Say = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Check:
    """What the recordings say.

    Parameters
    ----------
    replay : Replay
    ladder : Ladder or None
        None where no severity is declared.
    extremes : Extremes or None
        None where too few events come near a crash.
    tails : tuple of Tail
    influential : Influential or None
        None where the model expects no crash in what the campaign learned.
    rivals : tuple of Rival
        Other laws of traffic, for comparison.
    n_duplicates : int
        Recorded events that equal an earlier one in every digit.
    """

    replay: Replay
    ladder: Ladder | None
    extremes: Extremes | None
    tails: tuple[Tail, ...]
    influential: Influential | None
    rivals: tuple[Rival, ...]
    n_duplicates: int

    def alarms(self, estimate: Estimate) -> tuple[Alarm, ...]:
        """Doubts that the recordings cast on the estimate."""
        low, high = _claimed(estimate)
        raised = {
            Alarm.TAIL_MISFIT: self.ladder is not None and self.ladder.misfit,
            Alarm.EXTREMES_DISAGREE: (
                self.extremes is not None and _apart(self.extremes.interval, (low, high))
            ),
            Alarm.REPLAY_DISAGREES: _apart(self.replay.interval, (low, high)),
            Alarm.FEW_EVENTS_DECIDE: self.influential is not None and self.influential.few,
        }
        return tuple(alarm for alarm, is_raised in raised.items() if is_raised)

    def sentences(self, estimate: Estimate) -> list[str]:
        """What to read below the answer: the replay, and what few events decide."""
        said = estimate.traffic_range is not None and estimate.traffic_range.undetermined
        own = self.influential
        spoken = [self.replay.sentence()]
        if own is not None and (own.few or own.open_wide) and not said:
            spoken.append(own.sentence(self.replay.n_events))
        return spoken

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
        )


def _claimed(estimate: Estimate) -> tuple[float, float]:
    """The least and the largest probability that the answer allows."""
    low, high = estimate.interval
    found = estimate.traffic_range
    quantiles = [] if found is None else [q for q in found.quantiles if math.isfinite(q)]
    return min([low, *quantiles]), max([high, *quantiles])


def _apart(a: tuple[float, float], b: tuple[float, float]) -> bool:
    return a[1] < b[0] or b[1] < a[0]


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
    say("checking the recordings: severity ladder")
    modelled = c.traffic.modelled
    draws = c.draws(modelled.average, 0)
    ratios = modelled.member_ratios(draws.x) if modelled.members else np.ones((len(draws.x), 1))
    steps = _ladder(c, draws, ratios) if c.severity else None
    say("checking the recordings: margins and near misses")
    near = tails(quantities, c.events.values, _ordinary(c))
    say("checking the recordings: influence of single events")
    moved = _influential(c, draws, ratios[:, 0])
    say("checking the recordings: other laws of traffic")
    laws = alternatives(c.z, modelled.lower, modelled.upper)
    rivals = tuple(rival(c, law, 10 * (1 + k)) for k, law in enumerate(laws))
    return Check(replay, steps, _extremes(c), near, moved, rivals, n_duplicates(c.events.values))


def _ladder(c: Comparison, draws: Draws, ratios: FloatArray) -> Ladder:
    members = draws.under(ratios) if c.traffic.members else np.empty((0, len(c.levels)))
    return ladder(c.levels, c.first, draws.probabilities, members, c.rng(2))


def _ordinary(c: Comparison) -> FloatArray:
    """Draws of the traffic model, many more than the events."""
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
    """By the severity factors at which the worst events begin to crash."""
    if c.severity is None:
        return None
    x, factor = c.events.values, c.levels[-1]
    worst = c.first < len(c.levels)
    while worst.sum() <= N_EXCEEDANCES and factor < MAX_FACTOR:
        factor *= FACTOR_STEP
        worst = c.crashes(c.severity(x, factor))
    critical = c.severity.critical_factors(x[worst], c.crashes, MIN_FACTOR, factor)
    return extremes(np.log(critical), len(x))


def n_duplicates(x: FloatArray) -> int:
    """Rows of x (n, d) that equal an earlier one."""
    return len(x) - len(np.unique(x, axis=0))
