"""A pool seen through the outcomes so far: the probability that each of its draws crashes."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from crashrate.crash_set.surrogate import Surrogate
from crashrate.estimation.failing import fails
from crashrate.estimation.labels import Labels
from crashrate.sampling.pool import Pool
from crashrate.variables import BoolArray, FloatArray

# Least scale of the surrogate's coordinates, over the spread of the pool: a single coordinate's
# edge is soon known so well that earlier runs would lie 10⁵ scales away, beyond double precision.
MIN_SCALE = 0.01
ROUNDING = 1e-12
# Variance of the scaled coordinates, in the direction in which it is least, below which they are
# made round (where no order needs them as they are), down to the least that is stretched in full;
# and the effective number of draws, for each coordinate, from which on it is known well enough. The
# kernels are round: a thin oblique strip of crashes ended for them where the runs along it did, and
# up to a third of the probability was lost, where a strip along a coordinate was all found. (Edges
# stretched without limit cost a quarter more runs.)
THIN, THINNEST, ROUND_FROM = 0.15, 0.015, 10
MAX_DRIFT = 0.3  # of center over scale, and of log scale, before the coordinates follow
# A surrogate is never certain; but ordinary traffic has all the weight there is, and at 1e-9 it
# would be taken for the largest doubt of all where crashes are rare and coordinates many.
UNSURE, UNSURE_OF_CRASH = 1e-20, 1e-9
SHARP = 1e3  # variance of kernels under which outcomes differ across an edge, not by chance
FAR = 1e-3  # without an order, what the surrogate holds below this is taken as safe …
FAR_PROBABILITY = 1e-26  # … (NO_ORDER alarm): its tails are the prior's, not the data's
OBJECTION = 0.5  # an implied label counts unless the surrogate holds the opposite likelier
# An implied outcome keeps at least EDGE_DOUBT where it is implied by less than a ripple's depth and
# the surrogate's edge is within two of them, so that it is simulated now and then. Certainty would
# lose the crashes of a set that is monotone but for ripples at its edge: 2 % of the probability of
# the ACC+AEB plant (its 0.1 s control step). Ripples are as deep as the deepest contradiction seen,
# and at least RIPPLE scales of the surrogate. A smooth edge has next to no mass so near. A safe
# outcome deeper among implied crashes, RIPPLE units and more, is a hole.
RIPPLE, EDGE_DOUBT = 0.05, 0.01
# Exponents of the traffic density and of h (1-h) where outcomes teach most. What is deep, a hole or
# a false order, is told in units of a broader measure: near the likely crashes they would be up to
# three times as small, and the ACC+AEB vehicle lost its order over ripples after 990 runs.
LEARN_DENSITY, BREADTH_DENSITY, LEARN_VARIANCE = 0.5, 0.2, 3.0
# Without an order the surrogate alone says where the edge is, and takes too much beyond it for
# safe: with runs in the middle of its doubt it grew slowly, and rounds began at 0.4 to 0.9 of a
# disc.
LEARN_VARIANCE_ALONE = 1.0
# Power of the standard deviation that draws follow where outcomes contradict the order: the
# surrogate is too sure of itself there, by 1.3 to 1.4 in standard deviation, and what it held
# hardly likely is what estimates miss.
ROUGH_POWER = 0.9


@dataclass(frozen=True)
class Standardiser:
    """Shift and scale of the risk coordinates the surrogate sees.

    Parameters
    ----------
    center, scale : ndarray, shape (m,)
    unit : ndarray, shape (m,)
        Of the coordinates, for how deep outcomes contradict an order.
    mix : ndarray, shape (m, m), or None
        What the scaled coordinates are multiplied by from the right; None for nothing.
    """

    center: FloatArray
    scale: FloatArray
    unit: FloatArray
    mix: FloatArray | None = None

    def __call__(self, u: FloatArray) -> FloatArray:
        """Standardised coordinates."""
        scaled = (u - self.center) / self.scale
        return scaled if self.mix is None else scaled @ self.mix

    def or_else(self, other: Self) -> Self:
        """These coordinates, or `other` where the two differ by much.

        While the coordinates stay, so do the surrogate's sites: a fit to ten more labels then
        converges in a few sweeps.
        """
        shift = np.abs(self(other.center[None]))
        if max(shift.max(), self._stretched(other)) >= MAX_DRIFT:
            return other
        drifted = _stretch(self.unit, other.unit) >= MAX_DRIFT
        return replace(self, unit=other.unit) if drifted else self

    def _stretched(self, other: Self) -> float:
        """How far coordinates are stretched on the way to those of `other`, in logarithms."""
        if self.mix is None and other.mix is None:
            return _stretch(self.scale, other.scale)
        way = np.linalg.solve(self._linear, other._linear)
        return float(np.abs(np.log(np.linalg.svd(way, compute_uv=False))).max())

    @property
    def _linear(self) -> FloatArray:
        mix = np.eye(len(self.scale)) if self.mix is None else self.mix
        return np.asarray(mix / self.scale[:, None])

    @classmethod
    def weighted(
        cls,
        u: FloatArray,
        weights: FloatArray,
        broad: FloatArray | None = None,
        *,
        free: bool = False,
    ) -> "Standardiser":
        """Weighted mean and standard deviation of `u` (n, m), the latter with a floor.

        The unit is the standard deviation by the weights `broad` (n,), if they are others. Where
        no coordinate has a meaning of its own, `free`, an oblique and thin spread is made round.
        """
        center, scale = _spread(u, weights)
        mix = _rounded((u - center) / scale, weights) if free else None
        return cls(center, scale, scale if broad is None else _spread(u, broad)[1], mix)


def _rounded(z: FloatArray, weights: FloatArray) -> FloatArray | None:
    """What makes the spread of scaled coordinates `z` (n, m) round, if it is thin; else None."""
    if 1 / float(weights @ weights) < ROUND_FROM * z.shape[1]:
        return None
    thin, axes = np.linalg.eigh((z.T * weights) @ z)
    if thin[0] > THIN:
        return None
    return np.asarray(axes / np.sqrt(np.maximum(thin, THINNEST)))


def _stretch(scale: FloatArray, other: FloatArray) -> float:
    return float(np.abs(np.log(other / scale)).max())


def _spread(u: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    center = weights @ u
    scale = np.sqrt(weights @ (u - center) ** 2)
    scale = np.maximum(scale, MIN_SCALE * u.std(axis=0))
    varies = scale > ROUNDING * np.abs(u).max(axis=0)  # a coordinate may be constant
    return center, np.where(varies, scale, 1.0)


@dataclass(frozen=True)
class Moments:
    """What is held about a number in [0, 1] that a run at each draw comes to.

    Parameters
    ----------
    mean, square : ndarray, shape (n,)
        Expectation of the number and of its square.
    """

    mean: FloatArray
    square: FloatArray

    @cached_property
    def deviation(self) -> FloatArray:
        """Its standard deviation."""
        return np.sqrt(np.maximum(self.square - self.mean**2, 0.0))


@dataclass(frozen=True)
class View:
    """A pool with what is held about each draw.

    Parameters
    ----------
    pool : Pool
    h : ndarray, shape (n,)
        P(crash | outcomes): the surrogate's, its doubt reduced where the order decides.
    surrogate_h : ndarray, shape (n,)
        The surrogate's, everywhere.
    inner, safe : ndarray of bool, shape (n,)
        Presumed to crash, presumed to be safe, and the surrogate does not object.
    implied_inner, implied_safe : ndarray of bool, shape (n,)
        Implied by outcomes that nothing contradicts, whatever the surrogate says: for the bounds.
    failing : ndarray of bool, shape (n,)
        Undecided, and the nearest runs all failed: more would tell nothing.
    ordered : bool
        Whether a risk order is in use.
    consequences : tuple of Moments
        Of the event.
    aim : int or None
        The consequence that is aimed at; None for the event itself.
    rough : bool
        Whether outcomes contradict the order in use: at such an edge the surrogate is too sure.
    neglected : float
        Share of `probability` whose part in the variance of a round is left out.
    """

    pool: Pool
    h: FloatArray
    surrogate_h: FloatArray
    inner: BoolArray
    safe: BoolArray
    implied_inner: BoolArray
    implied_safe: BoolArray
    failing: BoolArray
    ordered: bool
    consequences: tuple[Moments, ...] = ()
    aim: int | None = None
    rough: bool = False
    neglected: float = 0.0

    @cached_property
    def weights(self) -> FloatArray:
        """f / (n q) of each draw."""
        return self.pool.weights

    @property
    def undecided(self) -> BoolArray:
        """Neither implied to crash nor to be safe, and not failing."""
        return ~(self.inner | self.safe | self.failing)

    @cached_property
    def spread(self) -> FloatArray:
        """Weight times standard deviation of the outcome: what a run at the draw can tell."""
        return np.where(self.failing, 0.0, self.weights * np.sqrt(self.h * (1 - self.h)))

    @cached_property
    def negligible(self) -> BoolArray:
        """Draws of least `h` that together have no more than the share `neglected`.

        Where a crash is that unlikely hardly any campaign meets one. Their part in the variance is
        that of the rarest of estimates, far too high; nearly all are too low by their share.
        """
        rows = np.argsort(self.h, kind="stable")
        mass = np.cumsum((self.weights * self.h)[rows])
        found = np.empty(len(rows), dtype=np.bool_)
        found[rows] = mass <= self.neglected * mass[-1]
        return found

    @cached_property
    def usual_spread(self) -> FloatArray:
        """The `spread` without what is negligible: what a usual round's error comes from."""
        return np.where(self.negligible, 0.0, self.spread)

    @property
    def aimed_spread(self) -> FloatArray:
        """What a run at the draw can tell of the number that is aimed at."""
        if self.aim is None:
            return self.spread
        deviation = self.consequences[self.aim].deviation
        return np.where(self.failing, 0.0, self.weights * deviation)

    @property
    def drawing(self) -> FloatArray:
        """What the draws that estimate are proportional to; flatter at a rough edge."""
        if not self.rough:
            return self.aimed_spread
        return np.asarray(self.weights ** (1 - ROUGH_POWER) * self.aimed_spread**ROUGH_POWER)

    @cached_property
    def probability(self) -> float:
        """The crash probability if h were right."""
        return float(self.weights @ self.h)

    @property
    def pool_variance(self) -> float:
        """Of `probability`, because the pool is finite."""
        return self.variance_of(self.h)

    def variance_of(self, held: FloatArray) -> float:
        """Of Σ w held (n,), because the pool is finite."""
        part, total = self.weights * held, float(self.weights @ held)
        return max(float(part @ part) - total**2 / self.pool.n_drawn, 0.0)

    @cached_property
    def alike(self) -> FloatArray:
        """Weight of each draw, of those denser than the likeliest crash cut to about as much.

        By the square of the ratio of densities: under normal traffic what is denser, and what is
        less dense, then weigh about the same.
        """
        log_f = self.pool.log_f
        crashing = log_f[(self.surrogate_h > OBJECTION) & np.isfinite(log_f)]
        if not len(crashing):
            return self.weights
        denser = np.maximum(log_f - crashing.max(), 0.0)
        return np.asarray(self.weights * np.exp(-2 * denser))

    @cached_property
    def learning(self) -> FloatArray:
        """Distribution over draws, ∝ √f (h (1-h))³ / q: where outcomes teach most.

        Without an order ∝ √f h (1-h) / q.
        """
        variance = LEARN_VARIANCE if self.ordered else LEARN_VARIANCE_ALONE
        return self._doubtful(LEARN_DENSITY, variance)

    @cached_property
    def breadth(self) -> FloatArray:
        """Distribution over draws, ∝ f^0.2 (h (1-h))³ / q: the edge as far as it is of interest.

        With or without an order.
        """
        return self._doubtful(BREADTH_DENSITY, LEARN_VARIANCE)

    def _doubtful(self, power: float, variance: float) -> FloatArray:
        """Distribution over draws, ∝ f^power (h (1-h))^variance / q."""
        doubt = np.where(self.failing, 0.0, np.maximum(self.h * (1 - self.h), 1e-300))
        with np.errstate(divide="ignore"):
            doubt = variance * np.log(doubt)
        log = power * self.pool.log_f + doubt - self.pool.log_q
        top = np.max(log)  # -inf where the simulator fails everywhere
        return normalised(np.exp(log - top) if np.isfinite(top) else np.zeros(len(log)))

    @cached_property
    def target(self) -> FloatArray:
        """Distribution over draws, ∝ w √E[z²] of what is aimed at, w √h for the event itself."""
        square = self.h if self.aim is None else self.consequences[self.aim].square
        return normalised(self.weights * np.sqrt(square))

    def under(self, ratio: FloatArray) -> Self:
        """As other traffic sees it: with `ratio` (n,) times the density, up to a factor."""
        with np.errstate(divide="ignore"):  # what has no density there has no weight
            log_f = self.pool.log_f + np.log(ratio)
        return replace(self, pool=replace(self.pool, log_f=log_f, ratios=None))

    def bounds(self) -> tuple[float, float]:
        """P(inner) and P(outer) under the pool, two standard errors to the safe side."""
        inner, inner_se = self._mass(self.implied_inner)
        outer, outer_se = self._mass(~self.implied_safe)
        return max(inner - 2 * inner_se, 0.0), min(outer + 2 * outer_se, 1.0)

    def _mass(self, member: BoolArray) -> tuple[float, float]:
        part = self.weights[member]
        total = float(part.sum())
        square = max(float(part @ part) - total**2 / self.pool.n_drawn, 0.0)
        return total, math.sqrt(square)


def see(pool: Pool, labels: Labels, surrogate: Surrogate, standardise: Standardiser) -> View:
    """Look at `pool` through the outcomes and the surrogate fitted to them."""
    h, raw, inner, outside = held(pool.u, labels, surrogate, standardise)
    crash, safe = labels.implied(pool.u)
    runs = standardise(labels.u)
    known = np.concatenate([runs[labels.known], surrogate.u])  # ordinary traffic taken as safe too
    failing = fails(known, runs[~labels.known], standardise(pool.u)) & ~(inner | outside)
    ordered = labels.learned is not None
    rough = ordered and labels.contradictions > 0
    return View(pool, h, raw, inner, outside, crash, safe, failing, ordered, rough=rough)


def held(
    u: FloatArray, labels: Labels, surrogate: Surrogate, standardise: Standardiser
) -> tuple[FloatArray, FloatArray, BoolArray, BoolArray]:
    """What is held about risk coordinates `u` (n, m): `h`, `surrogate_h`, `inner`, `safe`."""
    seen = surrogate.predict(standardise(u))
    raw = np.clip(seen.probability, UNSURE, 1 - UNSURE_OF_CRASH)
    presumed_crash, presumed_safe = labels.presumed(u)
    inner, outside = presumed_crash & (raw > 1 - OBJECTION), presumed_safe & (raw < OBJECTION)
    h = np.where(inner, 1.0, np.where(outside, 0.0, raw))
    ripple = labels.contradiction_gaps(standardise.scale).max(initial=RIPPLE)
    deep = labels.implied_deep(u, ripple * standardise.scale)
    edge = (inner | outside) & (np.abs(seen.danger) < 2 * ripple) & ~deep
    h = np.where(edge, np.clip(raw, EDGE_DOUBT, 1 - EDGE_DOUBT), h)
    n_holes, n_tested = labels.exceptions(RIPPLE * standardise.unit)
    if n_holes:
        h = np.where(inner, np.minimum(h, 1 - n_holes / n_tested), h)
    if labels.learned is None and surrogate.prior.variance >= SHARP:
        h = np.where(h < FAR, FAR_PROBABILITY, h)
    return h, raw, inner, outside


def normalised(weights: FloatArray) -> FloatArray:
    """`weights` divided by their sum; uniform where that is 0."""
    total = weights.sum()
    return weights / total if total > 0 else np.full(len(weights), 1 / len(weights))
