"""When outcomes contradict a declared risk order so much that it is given up."""

from enum import Enum, auto

from crashrate.estimation.labels import Labels, n_to_discard
from crashrate.variables import FloatArray

# So many outcomes, at least, would have to be discarded for the others to agree with the order.
MAX_DISCARDED, MAX_DISCARDED_SHARE = 8, 0.06
DEEP = 0.25  # standardised units: deeper than a ripple at the crash set's edge


class Verdict(Enum):
    """What the outcomes say of the order."""

    STANDS = auto()
    ROUGH = auto()  # danger may grow as declared, but near the runs no outcome implies another:
    # trusting them there lost a quarter of a probability
    FALSE = auto()  # contradicted by more than ripples


def verdict(labels: Labels, scale: FloatArray) -> Verdict:
    """Whether the order stands, with the surrogate's units `scale` (m,) for what is deep."""
    gaps = labels.contradiction_gaps(scale)
    limit = max(MAX_DISCARDED, MAX_DISCARDED_SHARE * labels.n)
    if n_to_discard(gaps > DEEP) > limit:
        return Verdict.FALSE
    return Verdict.ROUGH if n_to_discard(gaps > 0) > limit else Verdict.STANDS
