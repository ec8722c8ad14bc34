"""Held-out likelihood: how well a fit of four fifths of the events foretells the others."""

import math
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from threadpoolctl import threadpool_limits

from crashrate.errors import InvalidInputError, NumericalError
from crashrate.traffic.mixture import TruncatedGaussianMixture
from crashrate.traffic.model import TrafficModel
from crashrate.variables import BoolArray, FloatArray

SHARE = 0.2  # of the events that are held out
PER_EVENTS = 1000  # gains are told for so many: those of one event have too many zeros


def held_out_events(rows: FloatArray, seed: int) -> BoolArray:
    """Which events (n,) of rows (n, d) to hold out: about a fifth, equal events together.

    A recording repeats events; one that lay in both parts would be foretold by itself. So each
    event draws its part by its own bits, hashed with the seed.
    """
    bits = np.ascontiguousarray(rows + 0.0).view(np.uint64)  # + 0.0: -0.0 has bits of its own
    factors = np.random.default_rng(seed).integers(2**64, size=bits.shape[1], dtype=np.uint64)
    hashed = bits @ (factors | np.uint64(1))
    return np.asarray(_mixed(hashed) < np.uint64(SHARE * 2**64))


def _mixed(words: Any) -> Any:
    """Words of 64 bits, every bit of the answer owed to every bit of the word (SplitMix64)."""
    words = (words ^ (words >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    words = (words ^ (words >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return words ^ (words >> np.uint64(31))


def held_out_score(
    model: TrafficModel, rows: FloatArray, parameters: dict[str, Any], seed: int
) -> float:
    """Mean log density of held-out events, in the units of the data, under a fit of the others.

    Parameters
    ----------
    model : TrafficModel
        The fit of all events.
    rows : ndarray (n, d)
        All events.
    parameters : dict
        Of the fit.
    seed : int
        Of the split.

    Returns
    -------
    float
        nan where the part that is left cannot be fitted.
    """
    # Warm: the second fit starts from the first. On 157,757 lane changes it ends where a cold one
    # ends that climbs the same hill (to 1e-5 per event: next to nothing leaks), in a quarter of the
    # time, and scores the hill that is being judged; a cold start may well climb another one.
    start = {
        "weights_init": model.weights,
        "means_init": model.means,
        "precisions_init": np.linalg.inv(model.covariances),
    }
    out = held_out_events(rows, seed)
    if not out.any():
        return math.nan
    mixture = TruncatedGaussianMixture(
        model.n_components, random_state=seed, **{**parameters, **start}
    )
    with warnings.catch_warnings(), threadpool_limits(limits=1, user_api="blas"):
        warnings.simplefilter("ignore", ConvergenceWarning)  # that of the first fit is told
        try:
            return mixture.fit(rows[~out]).score(rows[out])
        except (NumericalError, InvalidInputError):  # too few events for a fifth to be spared
            return math.nan


def held_out_gains(held_out: Sequence[Sequence[float | None]]) -> FloatArray:
    """Held-out scores (n_candidates, n_restarts) on a scale where the candidates can be compared.

    A split has hard or easy events for all candidates alike, and that is most of what scores
    differ by. So each split's scores count from the split's median candidate; then all are moved
    so that the highest median over the splits is 0, and are told per `PER_EVENTS` events. None and
    nan are scores that are missing.
    """
    scores = np.array(held_out, dtype=np.float64)
    gains = scores - medians(scores.T)
    middle = medians(gains)
    highest = np.max(middle, where=~np.isnan(middle), initial=-np.inf)
    return np.asarray(PER_EVENTS * (gains - highest))


def medians(rows: FloatArray) -> FloatArray:
    """Median of each row of (n, m), what is missing (nan) aside; nan where all of it is."""
    there = [row[~np.isnan(row)] for row in rows]
    return np.array([np.median(row) if len(row) else np.nan for row in there])
