"""What a finished campaign holds about any situation: its crash set, as learned."""

from dataclasses import dataclass

import numpy as np

from crashrate.crash_set.surrogate import Surrogate
from crashrate.estimation.labels import Labels
from crashrate.estimation.view import Standardiser, held
from crashrate.sampling.pool import Density
from crashrate.variables import FloatArray

BLOCK = 16_384  # rows looked at together: the order compares each with every outcome


@dataclass(frozen=True, eq=False)
class Seen:
    """What is held about n situations.

    Parameters
    ----------
    h : ndarray (n,)
        P(crash | outcomes), the order and all cautions counted.
    surrogate_h : ndarray (n,)
        The surrogate's, everywhere.
    """

    h: FloatArray
    surrogate_h: FloatArray


@dataclass(frozen=True, eq=False)
class Belief:
    """The probability that a situation crashes, given all outcomes of a campaign.

    It steers the campaign and never answers in its place. Afterwards it says which recorded
    events are worth a simulator run, and compares recordings with traffic models.

    Parameters
    ----------
    labels : Labels
        Outcomes, and what they imply.
    surrogate : Surrogate
        Fitted to them.
    standardise : Standardiser
        The surrogate's coordinates.
    proposal : Density
        Draws where the crashes are that traffic brings.
    """

    labels: Labels
    surrogate: Surrogate
    standardise: Standardiser
    proposal: Density

    def __call__(self, z: FloatArray) -> FloatArray:
        """P(crash | outcomes) (n,) at rows z (n, d) of the campaign's own variables."""
        return self.see(z).h

    @property
    def ordered(self) -> bool:
        """Whether outcomes imply others through a risk order."""
        return self.labels.learned is not None

    def see(self, z: FloatArray) -> Seen:
        """The same, and the surrogate's own opinion, at rows z (n, d)."""
        parts = [self._block(z[i : i + BLOCK]) for i in range(0, len(z), BLOCK)]
        return Seen(*np.concatenate([np.empty((2, 0)), *parts], axis=1))

    def _block(self, z: FloatArray) -> FloatArray:
        u = self.labels.coordinates(z)
        h, raw, _, _ = held(u, self.labels, self.surrogate, self.standardise)
        return np.stack([h, raw])
