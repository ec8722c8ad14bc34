"""Risk coordinates that no order can be learned in: refused before any run."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from crashrate.errors import InvalidInputError
from crashrate.variables import FloatArray

# Range of a risk coordinate over that of the middle half of its values. Far beyond, distances come
# to nothing in double precision.
MOST_UNEVEN = 1e12


def require_usable(names: Sequence[str], u: FloatArray) -> None:
    """Refuse risk coordinates that do not vary, contradict each other, or are wildly uneven.

    Parameters
    ----------
    names : sequence of str, length m
    u : ndarray, shape (n, m)
        Of draws of traffic and beyond, danger growing in each.

    Raises
    ------
    InvalidInputError
        Named with what to declare instead.
    """
    _require_varying(names, u)
    _require_agreeing(names, u)
    _require_even(names, u)


def _require_varying(names: Sequence[str], u: FloatArray) -> None:
    if len(constant := np.flatnonzero(np.ptp(u, axis=0) == 0)):
        k = int(constant[0])
        raise InvalidInputError(
            f"risk coordinate {names[k]!r}: expected values that differ between situations, got "
            f"{abs(u[0, k]):g} for all; leave it out."
        )


def _require_agreeing(names: Sequence[str], u: FloatArray) -> None:
    """Of two coordinates one must not fall wherever the other rises: no two situations compare.

    (Where one is level between situations they do.)
    """
    for i, j in combinations(range(len(names)), 2):
        if np.all(np.diff(u[np.argsort(u[:, i]), j]) < 0):
            raise InvalidInputError(
                f"risk coordinates {names[i]!r} and {names[j]!r}: expected claims that can hold "
                "together, got two of which one falls wherever the other rises; one of the "
                "directions is wrong."
            )


def _require_even(names: Sequence[str], u: FloatArray) -> None:
    half = np.subtract(*np.quantile(u, (0.75, 0.25), axis=0))
    wild = np.flatnonzero((half > 0) & (np.ptp(u, axis=0) > MOST_UNEVEN * half))
    if len(wild):
        k = int(wild[0])
        raise InvalidInputError(
            f"risk coordinate {names[k]!r}: expected values of comparable size, got "
            f"a range {np.ptp(u[:, k]) / half[k]:.0e} times that of the middle half of them; "
            "declare an increasing function of it instead, such as its logarithm: the order that "
            "it claims is the same."
        )
