"""The standard normal on an interval: probability, moments and draws, accurate in any tail."""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt
from numpy.polynomial.legendre import leggauss
from scipy.special import erf, erfcx, log_ndtr, ndtr, ndtri, ndtri_exp

from crashrate.variables import BoolArray, FloatArray

LOG_SQRT_2PI = 0.5 * math.log(2.0 * math.pi)
_SQRT_HALF = math.sqrt(0.5)
# The narrow-interval rule: 8 nodes integrate exp of a quadratic smaller than this to 1e-16.
_NARROW = 0.5
# ndtr below this point has fewer than its 16 digits left after the next subtraction.
_FAR_LEFT = -30.0


@cache
def gauss_legendre(n: int) -> tuple[FloatArray, FloatArray]:
    """Nodes (n,) and weights (n,) of the Gauss-Legendre rule on [-1, 1]."""
    nodes, weights = leggauss(n)
    return nodes, weights


def log_interval_probability(lower: npt.ArrayLike, upper: npt.ArrayLike) -> FloatArray:
    """log P(lower <= Z <= upper) for a standard normal Z, to rounding in any tail.

    Parameters
    ----------
    lower, upper : array_like
        Broadcast against each other, infinite where the interval is open; lower < upper.

    Returns
    -------
    ndarray
        -inf where the interval is narrower than rounding.
    """
    low, high = np.broadcast_arrays(np.asarray(lower, float), np.asarray(upper, float))
    mirrored = high < -low
    near = np.where(mirrored, -high, low)  # the end nearer to 0, or the negative one
    far = np.where(mirrored, -low, high)
    tail = near > 0
    out = np.empty(near.shape)
    with np.errstate(divide="ignore"):  # log 0 = -inf is the documented answer
        body = ~tail
        a, b = near[body], far[body]
        out[body] = np.log(0.5 * (erf(_SQRT_HALF * b) - erf(_SQRT_HALF * a)))
        out[tail] = _log_tail(near[tail], far[tail])
    return out


def _log_tail(a: FloatArray, b: FloatArray) -> FloatArray:
    """log P(a <= Z <= b) for 0 < a < b: the density at a times a scaled difference."""
    scaled = 0.5 * erfcx(_SQRT_HALF * a)
    closed = np.isfinite(b)
    if closed.any():  # most tails are open: spare them the second term
        _close_tail(scaled, a, b, closed)
    return np.asarray(np.log(scaled) - 0.5 * a * a)


def _close_tail(scaled: FloatArray, a: FloatArray, b: FloatArray, closed: BoolArray) -> None:
    """Take the mass beyond b off `scaled`, in place, where the interval is closed."""
    drop = 0.5 * (b - a) * (b + a)  # how far the log density falls from a to b
    scaled[closed] -= 0.5 * np.exp(-drop[closed]) * erfcx(_SQRT_HALF * b[closed])
    narrow = drop < _NARROW  # where the difference above cancels
    if narrow.any():
        left, width = a[narrow, None], (b - a)[narrow, None]
        nodes, weights = gauss_legendre(8)
        step = 0.5 * width * (1.0 + nodes)
        area = (np.exp(-step * (left + 0.5 * step)) @ weights) * 0.5 * width[:, 0]
        scaled[narrow] = area / math.sqrt(2.0 * math.pi)


@dataclass(frozen=True, slots=True)
class Stretch:
    """The part of an interval that holds its mass: mode + [left, right]."""

    mode: FloatArray
    left: FloatArray
    right: FloatArray

    def split(self, breaks: FloatArray) -> "Stretch":
        """The stretch cut at offsets `breaks` (..., m): m + 1 panels, empty ones where outside."""
        left, right = self.left[..., None], self.right[..., None]
        inside = np.sort(np.clip(breaks, left, right), axis=-1)
        edges = np.concatenate([left, inside, right], axis=-1)
        return Stretch(self.mode[..., None], edges[..., :-1], edges[..., 1:])

    def nodes(self, n: int) -> tuple[FloatArray, FloatArray]:
        """Offsets from the mode (..., n) and log weights (..., n) of a Gauss-Legendre rule."""
        x, weights = gauss_legendre(n)
        half = 0.5 * (self.right - self.left)[..., None]
        offsets = 0.5 * (self.right + self.left)[..., None] + half * x
        with np.errstate(divide="ignore"):  # an empty stretch weighs nothing
            return offsets, np.log(weights) + np.log(half)


@dataclass(frozen=True, slots=True)
class Rule:
    """Gauss-Legendre nodes per stretch, and how far the log density may fall where it ends.

    With `split` a stretch is cut where the probability of a later link has its step, which
    strong correlation makes steep: nodes crowd at the ends of the panels, so they resolve it.
    """

    n: int
    log_drop: float
    split: bool = False


# exp(-35) = 6e-16: what lies beyond is rounding; 40 nodes are as good on the widest stretch.
FINE = Rule(40, 35.0)
# 1e-12 and 3e-9: enough for an optimiser, which takes this many thousand times over.
COARSE = Rule(24, 25.0)
# 1e-8, and 3e-4 where a component is thin and cut: enough to come near the answer.
ROUGH = Rule(14, 18.0)


def effective_stretch(lower: FloatArray, upper: FloatArray, log_drop: float) -> Stretch:
    """Where a standard normal on [lower, upper] has all its mass but exp(-log_drop) of it."""
    mode = np.maximum(lower, np.minimum(upper, 0.0))
    size = np.abs(mode)
    reach = 2.0 * log_drop / (np.sqrt(size * size + 2.0 * log_drop) + size)
    return Stretch(mode, np.maximum(lower - mode, -reach), np.minimum(upper - mode, reach))


@dataclass(frozen=True, slots=True)
class IntervalMoments:
    """Mean and central moments of a standard normal on intervals."""

    mean: FloatArray
    second: FloatArray
    third: FloatArray
    fourth: FloatArray


def interval_moments(lower: FloatArray, upper: FloatArray, rule: Rule = FINE) -> IntervalMoments:
    """Mean and central moments two to four of a standard normal on [lower, upper].

    Sums of positive terms over nodes: nothing cancels, however narrow or far out.
    """
    stretch = effective_stretch(lower, upper, rule.log_drop)
    x, weights = gauss_legendre(rule.n)
    half = 0.5 * (stretch.right - stretch.left)
    middle = 0.5 * (stretch.right + stretch.left)
    offsets = middle[..., None] + half[..., None] * x
    mass = np.exp(-offsets * (stretch.mode[..., None] + 0.5 * offsets)) * weights
    raw = mass @ np.stack([np.ones_like(x), x, x**2, x**3, x**4], axis=1)
    total = raw[..., 0]
    m1, m2, m3, m4 = (raw[..., k] / total for k in range(1, 5))
    second = m2 - m1 * m1
    third = m3 - 3.0 * m1 * m2 + 2.0 * m1**3
    fourth = m4 - 4.0 * m1 * m3 + 6.0 * m1 * m1 * m2 - 3.0 * m1**4
    mean = stretch.mode + middle + half * m1
    return IntervalMoments(mean, second * half**2, third * half**3, fourth * half**4)


def quantile(u: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Quantiles u in (0, 1) of a standard normal on [lower, upper], by inversion.

    Worked in the left tail, where the distribution function keeps its relative accuracy.
    """
    mirrored = upper > -lower
    low = np.where(mirrored, -upper, lower)
    high = np.where(mirrored, -lower, upper)
    p_low, p_high = ndtr(low), ndtr(high)
    out = np.empty(np.broadcast(u, low).shape)
    near: BoolArray = np.broadcast_to(high > _FAR_LEFT, out.shape)
    u = np.broadcast_to(np.where(mirrored, 1.0 - u, u), out.shape)
    out[near] = ndtri((p_low + u * (p_high - p_low))[near])
    if not near.all():
        far = ~near
        low_far, high_far = (np.broadcast_to(end, out.shape)[far] for end in (low, high))
        out[far] = _far_quantile(u[far], low_far, high_far)
    # Inversion rounds: a quantile a hair outside its interval belongs on the end.
    out = np.maximum(np.minimum(out, high), low)
    return np.asarray(np.where(mirrored, -out, out))


def _far_quantile(u: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """The same in logarithms, for intervals below _FAR_LEFT."""
    log_high = log_ndtr(high)
    ratio = -np.expm1(log_ndtr(low) - log_high)  # 1 - Phi(low) / Phi(high)
    return np.asarray(ndtri_exp(log_high + np.log1p(-(1.0 - u) * ratio)))
