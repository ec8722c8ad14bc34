"""Corners: the minimal elements of the set that no safe point dominates.

The outer set ∩_j ∪_k {u_k >= b^j_k} (§V.B of the 2017 paper) is written there as a union over
d^{n0} choices of one k for each j. It is the union of the orthants {u >= c} over far fewer
corners c, the *local bounds* of multi-objective optimisation: n0 + 1 of them for m = 2 risk
coordinates, at most 2 n0 + 1 for m = 3, Θ(n0^⌊m/2⌋) in general.

Reference: K. Klamroth, R. Lacour, D. Vanderpooten, "On the representation of the search region
in multi-objective optimization", European Journal of Operational Research 245 (2015), algorithm 2.
"""

import numpy as np

from crashrate.crash_set.fronts import above_any, minimal
from crashrate.variables import FloatArray


def first_corner(m: int) -> FloatArray:
    """The one corner while nothing is known to be safe: (-inf, …, -inf), shape (1, m)."""
    return np.full((1, m), -np.inf)


def cut(corners: FloatArray, safe: FloatArray) -> FloatArray:
    """The corners after one more point is known to be safe.

    Parameters
    ----------
    corners : (n, m) array
        Of the safe points so far.
    safe : (m,) array
        The new safe point b.

    Returns
    -------
    (n', m) array
        Every corner c < b (in all coordinates) replaced by its children, c with c_k := b_k,
        less those that another corner makes redundant.
    """
    strict = corners < safe
    hit = strict.all(axis=1)
    if not hit.any():
        return corners
    parents, kept = corners[hit], corners[~hit]
    # A child has exactly one coordinate of b, k, and is below b elsewhere. So what dominates it
    # also has c_k = b_k: a sibling made along k, or (a tie) an old corner that lies on b_k.
    on = (kept == safe) & (strict[~hit].sum(axis=1) == len(safe) - 1)[:, None]
    children = [_children(parents, kept[on[:, k]], safe, k) for k in range(len(safe))]
    return np.vstack([kept, *children])


def _children(parents: FloatArray, tied: FloatArray, safe: FloatArray, k: int) -> FloatArray:
    """Children of `parents` along k that neither each other nor the `tied` corners dominate."""
    children = parents.copy()
    children[:, k] = safe[k]
    if len(tied):
        children = children[~above_any(children, tied)]
    return minimal(children) if len(children) > 1 else children


def corners_of(safe: FloatArray) -> FloatArray:
    """The corners of all the safe points (n0, m), one `cut` after another."""
    corners = first_corner(safe.shape[1])
    for point in safe:
        corners = cut(corners, point)
    return corners
