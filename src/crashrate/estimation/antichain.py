"""Which undecided points to simulate first, so that the order decides most of the others."""

import numpy as np
import numpy.typing as npt

from crashrate.variables import FloatArray

# comparisons of all pairs are made among at most this many points
MAX_COMPARED = 300


def antichain(u: FloatArray, n: int) -> npt.NDArray[np.intp]:
    """At most n rows of u (k, m), no two of them comparable.

    A crash decides all points above it and a safe point all below: rows with many points both
    above and below come first, as in a bisection. No outcome of one decides another.

    Parameters
    ----------
    u : (k, m) array
        Risk coordinates.
    n : int
    """
    u = u[:MAX_COMPARED]
    below = np.ones((len(u), len(u)), dtype=np.bool_)
    for column in u.T:
        below &= column[:, None] <= column
    score = below.sum(axis=0) * below.sum(axis=1)
    chosen: list[int] = []
    while len(chosen) < n and score.any():
        best = int(score.argmax())
        chosen.append(best)
        score[below[best] | below[:, best]] = 0
    return np.sort(np.array(chosen, dtype=np.intp))
