"""The pieces of a comparison of recordings with a traffic model, by a learned crash set."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from crashrate.estimation.belief import Belief
from crashrate.estimation.exploration import INFLATION, inflated
from crashrate.events import EventTable
from crashrate.recordings.expectation import Draws, Law, Search, rare_draws
from crashrate.recordings.severity import Severity
from crashrate.traffic.model import TrafficModel
from crashrate.variables import BoolArray, FloatArray

STREAM = 4_000_000  # random streams beside those of the campaign


@dataclass(frozen=True, eq=False)
class Comparison:
    """The pieces that every part of a check needs.

    Parameters
    ----------
    events : EventTable
        Those that the traffic model was fitted to.
    traffic : TrafficModel
    belief : Belief
        Of the campaign.
    severity : Severity or None
    seed : int
    confidence : float
        Of intervals.
    """

    events: EventTable
    traffic: TrafficModel
    belief: Belief
    severity: Severity | None
    seed: int
    confidence: float = 0.95

    def crashes(self, x: FloatArray) -> BoolArray:
        """Which situations x (n, d) the campaign takes for crashes; none that is no situation.

        Making a draw worse may lead out of arithmetic: what is not finite then, or has no
        logarithm where one is modelled, is no crash.
        """
        scales = self.traffic.scales
        there = np.isfinite(x).all(axis=1) & ~((x <= 0) & scales.log).any(axis=1)
        crash = np.zeros(len(x), dtype=bool)
        crash[there] = self.belief(scales.forward(x[there])) >= 0.5
        return crash

    @cached_property
    def z(self) -> FloatArray:
        """The events (n, d) on the modelled scales."""
        return self.traffic.scales.forward(self.events.values)

    @cached_property
    def first(self) -> np.ndarray:
        """The level (n,) at which each event begins to crash."""
        return self.first_levels(self.events.values)

    @property
    def ordered(self) -> bool:
        """Whether the learned set rests on a risk order."""
        return self.belief.ordered

    @property
    def levels(self) -> tuple[float, ...]:
        """Of the ladder; 1 alone where no severity is declared."""
        return self.severity.levels if self.severity else (1.0,)

    def first_levels(self, x: FloatArray) -> np.ndarray:
        """The level (n,) at which each situation x (n, d) begins to crash."""
        if self.severity is None:
            return np.where(self.crashes(x), 0, 1)
        return self.severity.first_levels(x, self.crashes)

    def draws(self, law: Law, k: int) -> Draws:
        """Weighted draws of a law of the modelled variables, by the level at which they crash."""
        scales = self.traffic.scales
        search = Search(
            lambda z: self.first_levels(scales.back(z)),
            len(self.levels),
            self.belief.proposal,
            inflated(self.traffic.modelled.average, (INFLATION,)),
        )
        return rare_draws(law, search, self.rng(k))

    def rng(self, k: int) -> np.random.Generator:
        """The generator of part k."""
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(STREAM + k,)))
