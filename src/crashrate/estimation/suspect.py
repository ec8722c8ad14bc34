"""Which declared direction the outcomes speak against most: where to look first."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from crashrate.crash_set.order import RiskOrder
from crashrate.estimation.labels import n_to_discard
from crashrate.variables import BoolArray, FloatArray

MIN_DISCARDED = 3  # fewer are ripples, or bad luck
MOST_LEFT = 0.5  # of them, with the direction reversed: ripples are only more where it is wrong
N_LATEST = 2000  # outcomes: pairs of them grow with the square


@dataclass(frozen=True)
class Suspect:
    """A risk coordinate whose direction seems to be the other one.

    Parameters
    ----------
    coordinate : str
        Its name.
    n_outcomes : int
        Outcomes that were looked at.
    n_against, n_against_reversed : int
        How many of them would have to be discarded for the others to agree with the order as
        declared, and with this coordinate's direction reversed.
    """

    coordinate: str
    n_outcomes: int
    n_against: int
    n_against_reversed: int

    def sentence(self) -> str:
        """What to look at, and why."""
        return (
            f"look at the direction of {self.coordinate} first: of {self.n_outcomes} outcomes "
            f"{self.n_against} contradict the order as declared, {self.n_against_reversed} with "
            f"{self.coordinate} reversed"
        )

    def to_dict(self) -> dict[str, Any]:
        """As JSON-ready values."""
        return asdict(self) | {"sentence": self.sentence()}


def suspect(order: RiskOrder, x: FloatArray, y: FloatArray) -> Suspect | None:
    """The coordinate whose reversal leaves fewest outcomes y (n,) at x (n, d) against the order.

    None where no reversal makes them much fewer: then no single direction is to blame.
    """
    known = np.flatnonzero(~np.isnan(y))[-N_LATEST:]
    u, crash = order(x[known]), y[known] == 1
    against = _n_against(u, crash)
    if against < MIN_DISCARDED:
        return None
    left = [_n_against(_reversed(u, k), crash) for k in range(u.shape[1])]
    k = int(np.argmin(left))
    if left[k] > MOST_LEFT * against or left.count(left[k]) > 1:
        return None
    return Suspect(order.names[k], len(u), against, left[k])


def _reversed(u: FloatArray, k: int) -> FloatArray:
    sign = np.ones(u.shape[1])
    sign[k] = -1
    return u * sign


def _n_against(u: FloatArray, crash: BoolArray) -> int:
    """Least number of outcomes to discard for the others to agree with the order of `u` (n, m)."""
    at_least = np.ones((np.count_nonzero(crash), np.count_nonzero(~crash)), dtype=np.bool_)
    for column in u.T:  # a coordinate at a time: (crashes, safe) at once are enough
        at_least &= column[~crash][None] >= column[crash][:, None]
    return n_to_discard(at_least)
