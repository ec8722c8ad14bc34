"""The recorded events that decide the answer, by the infinitesimal jackknife."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from crashrate.estimation.traffic_range import UNDETERMINED
from crashrate.events import EventTable
from crashrate.traffic.influence import FittedMixture, influence
from crashrate.traffic.model import TrafficModel
from crashrate.variables import FloatArray

N_LISTED, N_FEW, FEW_SHARE = 10, 5, 0.5
LEAST_ERROR = 0.2  # where the events leave less open than this, nobody minds which they are
LARGEST_FACTOR = 1000.0
PRIOR_STRENGTH = 1.0  # of a model that does not say


@dataclass(frozen=True)
class InfluentialEvent:
    """One recorded event.

    Parameters
    ----------
    row : int
        In its file, counted from 1.
    change : float
        Of the probability if the event had been recorded twice, over the probability.
    variance_share : float
        Of the jackknife variance.
    situation : tuple of float, length d
    """

    row: int
    change: float
    variance_share: float
    situation: tuple[float, ...]


@dataclass(frozen=True)
class Influential:
    """Which events decide, and how far the events leave the number open.

    Parameters
    ----------
    events : tuple of InfluentialEvent
        The ten with most influence, most first.
    relative_error : float
        Standard error of the probability over itself, from the choice of events alone: at this
        number of components and this maximum of the likelihood.
    share_of_five : float
        Of the jackknife variance that the five foremost carry.
    n_flat : int
        Directions in which the likelihood is flat; their part is unknown.
    """

    events: tuple[InfluentialEvent, ...]
    relative_error: float
    share_of_five: float
    n_flat: int

    @property
    def few(self) -> bool:
        """Whether five events carry half of what the events leave open."""
        return self.share_of_five >= FEW_SHARE and self.relative_error >= LEAST_ERROR

    @property
    def open_wide(self) -> bool:
        """Whether the choice of events alone leaves the number open by more than a factor of 2."""
        return self.relative_error > UNDETERMINED

    @property
    def factor(self) -> float:
        """From the number to either end of 90 % of what other events would give; at most 1000."""
        return min(math.exp(min(1.645 * self.relative_error, 10.0)), LARGEST_FACTOR)

    def sentences(self, n_events: int, *, said: bool) -> list[str]:
        """What a reader must know of this; `said`: that the number is left open."""
        found = []
        if self.open_wide and not said:
            found.append(
                "influence: the choice of events alone leaves this number open by a factor "
                f"{self.factor:.1f} either way"
            )
        if self.few:
            found.append(
                f"influence: five of {n_events:,} events carry {100 * self.share_of_five:.0f} % "
                "of the variance that the choice of events leaves"
            )
        return found

    def to_dict(self) -> dict[str, Any]:
        """As JSON-ready values."""
        return vars(self) | {
            "events": [vars(e) | {"situation": list(e.situation)} for e in self.events]
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "Influential":
        """What `to_dict` wrote."""
        events = (
            InfluentialEvent(**{**e, "situation": tuple(e["situation"])}) for e in values["events"]
        )
        return cls(**{**values, "events": tuple(events)})


def influential(
    best: TrafficModel, events: EventTable, z: FloatArray, x: FloatArray, weights: FloatArray
) -> Influential:
    """Influence of the recorded events on the crash probability under a fit to them.

    Parameters
    ----------
    best : TrafficModel
        The fit, every scale linear.
    events : EventTable
    z : ndarray (n, d)
        The events on the modelled scales.
    x, weights : ndarray (m, d), (m,)
        Draws among the crashes, on the modelled scales; the weights sum to the probability.
    """
    strength = float(best.provenance.get("prior_strength", PRIOR_STRENGTH))
    found = influence(FittedMixture.of(best, z, strength), z, x, weights)
    p, variance = float(weights.sum()), found.standard_error**2
    listed = tuple(
        InfluentialEvent(
            int(events.rows[i]) + 1,
            float(found.per_event[i] / p),
            float(found.per_event[i] ** 2 / variance),
            tuple(events.values[i].tolist()),
        )
        for i in found.most(N_LISTED)
    )
    return Influential(listed, found.standard_error / p, found.variance_share(N_FEW), found.n_flat)
