"""When outcomes contradict a declared risk order so much that it is given up."""

from enum import Enum, auto

from crashrate.estimation.labels import Labels, n_to_discard
from crashrate.variables import BoolArray, FloatArray

# An order is given up where more outcomes than these, and than this share of all, would have to be
# discarded for the others to agree with it …
MAX_DISCARDED, MAX_DEEP_SHARE, MAX_ROUGH_SHARE = 8, 0.06, 0.03
# … but for contradictions shallower than ripples at the crash set's edge (`Standardiser.unit`).
# Ripples are contradicted by a share of the runs that grows with their number, as all runs come to
# lie at the edge: they are doubted there (`view.RIPPLE`), and counting them would at last drop any
# order that a simulator's time step blurs.
ROUGH, DEEP = 0.05, 0.25


class Verdict(Enum):
    """What the outcomes say of the order."""

    STANDS = auto()
    ROUGH = auto()  # danger may grow as declared, but near the runs no outcome implies another:
    # trusting them there lost a quarter of a probability
    FALSE = auto()  # contradicted by more than ripples


def verdict(labels: Labels, unit: FloatArray) -> Verdict:
    """Whether the order stands, with the `Standardiser.unit` (m,) for what is deep."""
    gaps = labels.contradiction_gaps(unit)
    if _too_many(gaps > DEEP, MAX_DEEP_SHARE * labels.n):
        return Verdict.FALSE
    if _too_many(gaps > ROUGH, MAX_ROUGH_SHARE * labels.n):
        return Verdict.ROUGH
    return Verdict.STANDS


def _too_many(contradict: BoolArray, most: float) -> bool:
    return n_to_discard(contradict) > max(MAX_DISCARDED, most)
