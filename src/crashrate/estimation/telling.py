"""A surrogate of more labels than it can be fitted to: of those that hold the edge in place."""

import math
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from crashrate.crash_set.surrogate import IntArray, Prior, Sites, Surrogate, fit_surrogate
from crashrate.variables import BoolArray, FloatArray

# A surrogate's cost grows with the cube of its labels. Of more than MAX_LABELS it is fitted to the
# new ones and, of at least MIN_OLD others, to those with the sharpest sites and, for the share
# SPREAD, to those that lie farthest from all these: a label is redundant while others hold the edge
# for it, and where they were all left out at once the edge gave way.
MAX_LABELS, MIN_OLD, SPREAD = 2000, 1000, 0.3
# labels that the fit gives less than this probability come back, at once if may be
UNEXPLAINED, MAX_FITS = 0.5, 3


def fit_telling(
    u: FloatArray, crash: BoolArray, prior: Prior, warm: Sites
) -> tuple[Surrogate, Sites]:
    """The surrogate of the telling labels, and the sites of all.

    Its score counts all labels: those left out by what it predicts for them.

    Parameters
    ----------
    u : ndarray, shape (n, m)
        Standardised risk coordinates.
    crash : ndarray of bool, shape (n,)
    prior : Prior
    warm : Sites
        Of earlier fits, one for each label; NaN for the new ones.
    """
    for _ in range(MAX_FITS):
        rows = telling(u, crash, warm.tau)
        fit = fit_surrogate(u[rows], crash[rows], prior, warm.of(rows))
        warm = warm.put(rows, fit.sites)
        if len(rows) == len(u):
            break
        left = np.delete(np.arange(len(u)), rows)
        log_probability, sites = fit.left_out(u[left], crash[left])
        warm = warm.put(left, sites)
        fit = replace(fit, log_score=fit.log_score + float(log_probability.sum()))
        if log_probability.min() > math.log(UNEXPLAINED):
            break
    return fit, warm


def telling(u: FloatArray, crash: BoolArray, tau: FloatArray) -> IntArray:
    """Rows of the labels to fit, in order: all where there are few.

    Parameters
    ----------
    u : ndarray, shape (n, m)
        Standardised risk coordinates.
    crash : ndarray of bool, shape (n,)
    tau : ndarray, shape (n,)
        Precisions of the labels' sites, NaN for the new ones.
    """
    if len(u) <= MAX_LABELS:
        return np.arange(len(u))
    new, old = np.flatnonzero(np.isnan(tau)), np.flatnonzero(~np.isnan(tau))
    new = _nearest_and_even(u, crash, new, MAX_LABELS - min(MIN_OLD, len(old)))
    by_precision = old[np.argsort(-tau[old], kind="stable")]
    room = MAX_LABELS - len(new)
    sharpest = by_precision[: room - round(SPREAD * room)]
    rows = np.concatenate([new, sharpest])
    rest = np.setdiff1d(old, sharpest)
    return np.sort(np.concatenate([rows, _farthest(u, rows, rest, MAX_LABELS - len(rows))]))


def _farthest(u: FloatArray, rows: IntArray, among: IntArray, n: int) -> IntArray:
    """`n` labels of `among`, one after another the farthest from `rows` and those before it."""
    distance = cKDTree(u[rows]).query(u[among])[0]
    chosen = np.empty(n, dtype=int)
    for i in range(n):
        best = int(distance.argmax())
        chosen[i] = among[best]
        distance = np.minimum(distance, np.sqrt(((u[among] - u[among[best]]) ** 2).sum(axis=1)))
    return chosen


def _nearest_and_even(u: FloatArray, crash: BoolArray, rows: IntArray, n: int) -> IntArray:
    """Up to `n` of `rows`: half nearest to the other outcome, half of the rest evenly in time.

    Of thousands of outcomes that come at once (a first crash after as many random encounters)
    nothing else is known.
    """
    if len(rows) <= n:
        return rows
    distance = np.full(len(u), np.inf)
    for side in (crash, ~crash):
        if side.any() and not side.all():
            distance[side] = cKDTree(u[~side]).query(u[side])[0]
    by_distance = rows[np.argsort(distance[rows], kind="stable")]
    nearest, rest = by_distance[: n - n // 2], np.sort(by_distance[n - n // 2 :])
    even = rest[np.linspace(0, len(rest) - 1, n // 2).round().astype(int)]
    return np.concatenate([nearest, even])
