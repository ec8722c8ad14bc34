"""Draws of a fixed proposal with their weights f/q: the estimate, and whether it may be believed.

A few hundred draws say little of a weight that is rare and large: without it mean and variance are
both too small. So the interval allows for one draw as heavy as the heaviest more or less, and its
upper end for skewed contributions. Where the heavy weights fall off too slowly for a variance to
mean anything, or the crashes are too few, that end is what the draws of ordinary traffic leave.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Self

import numpy as np

from crashrate.estimation.alarms import SHARE_LIMIT, Alarm
from crashrate.estimation.encounters import Encounters
from crashrate.estimation.tally import Tally
from crashrate.variables import BoolArray, FloatArray

MIN_N_EFF = 10.0  # the interval is not looked at before, as in the 2017 procedure
# Vehtari et al. (2024), "Pareto smoothed importance sampling": beyond it no finite number of draws
# is enough
MAX_TAIL_INDEX = 0.7
FEW = 20  # weights that tell no tail


@dataclass(frozen=True)
class WeightedDraws:
    """Draws and the outcomes of those inside the traffic model's box.

    Parameters
    ----------
    traffic_share : float
        Of the traffic model in the proposal; its inverse bounds the weights.
    tally : Tally
        Sums of the contributions w · 1{crash}.
    weights : ndarray, shape (k,)
        Of the draws that crashed.
    ordinary : Encounters
        The draws that came from the traffic model's share.
    """

    traffic_share: float
    tally: Tally = field(default_factory=Tally)
    weights: FloatArray = field(default_factory=lambda: np.empty(0))
    ordinary: Encounters = field(default_factory=Encounters)

    def add(self, w: FloatArray, y: FloatArray, came: BoolArray, n_drawn: int) -> Self:
        """With more draws.

        Parameters
        ----------
        w, y : ndarray, shape (n,)
            Weights f/q and outcomes (1 crash, 0 safe, NaN failed) of those inside the box.
        came : ndarray of bool, shape (n,)
            Which of them came from the traffic model's share.
        n_drawn : int
            Draws, those outside the box included: they add zero.
        """
        crashed, z = y == 1, np.zeros(n_drawn)
        z[: len(y)] = np.where(crashed, w, 0.0)
        return replace(
            self,
            tally=self.tally.add(z, w[np.isnan(y)]),
            weights=np.concatenate([self.weights, w[crashed]]),
            ordinary=self.ordinary + Encounters.of(y[came]),
        )

    @cached_property
    def tail_index(self) -> float:
        """Of the crashes' weights: the share w of them that exceeds t falls like t^(-1/index)."""
        return tail_index(self.weights)

    @property
    def heavy(self) -> bool:
        """Whether a few weights yet to come may outweigh all that were seen."""
        return self.tail_index > MAX_TAIL_INDEX

    @property
    def trusted(self) -> bool:
        """Whether the weights say how exact the mean is."""
        return self.tally.n_eff >= MIN_N_EFF and not self.heavy

    def interval(self, confidence: float) -> tuple[float, float]:
        """The interval of the mean; failed draws count as safe below and as crashes above."""
        low, high = self._of_weights(confidence)
        if not self.trusted or self.ordinary.speak_against(high):
            high = max(high, self.ordinary.interval(confidence)[1])
        return low, min(high, 1.0)

    def _of_weights(self, confidence: float) -> tuple[float, float]:
        tally = self.tally
        low, high = tally.interval(confidence, 1 / self.traffic_share)
        one = tally.largest / tally.n if tally.n else 0.0
        return max(low - one, 0.0), high + one + self._skew(confidence)

    def _skew(self, confidence: float) -> float:
        """How much the upper end moves because contributions are skewed (Johnson 1978)."""
        tally = self.tally
        if not tally.n_eff:
            return 0.0
        skewness = float((self.weights**3).sum()) / tally.squares**1.5  # of the mean's own law
        moved = skewness * (1 + 2 * tally.quantile(confidence) ** 2) / 6
        return float(moved * tally.standard_error)

    def alarms(self, confidence: float) -> tuple[Alarm, ...]:
        """The doubts that the draws leave."""
        tally = self.tally
        _, high = self._of_weights(confidence)
        raised = {
            Alarm.TOO_FEW_CRASHES: tally.n > 0 and tally.n_eff < MIN_N_EFF,
            Alarm.WEIGHTS_CONCENTRATED: tally.total > 0.0 and tally.largest_share > SHARE_LIMIT,
            Alarm.WEIGHTS_HEAVY_TAILED: len(self.weights) >= FEW and self.heavy,
            Alarm.ENCOUNTERS_DISAGREE: self.ordinary.speak_against(high),
        }
        return tuple(alarm for alarm, is_raised in raised.items() if is_raised)


def tail_index(weights: FloatArray) -> float:
    """Hill's estimate (1975) of a Pareto tail's index from the largest weights (k,); ∞ below `FEW`.

    From as many of them as Vehtari et al. (2024) take: a fifth, or 3 √k where that is fewer.
    """
    k = len(weights)
    if k < FEW:
        return np.inf
    n_tail = int(min(k / 5, 3 * np.sqrt(k)))
    ordered = np.sort(weights)[-n_tail - 1 :]
    return float(np.log(ordered[1:] / ordered[0]).mean())
