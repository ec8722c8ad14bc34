"""Integration nodes over a truncated normal: tensor or Sobol, the last link exact."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np

from crashrate.errors import NumericalError
from crashrate.traffic.one_dimension import (
    FINE,
    LOG_SQRT_2PI,
    Rule,
    effective_stretch,
    log_interval_probability,
    quantile,
)
from crashrate.traffic.tilting import Chain, IntArray, Tilting, saddle_points
from crashrate.variables import BoolArray, FloatArray

# Refined until two rungs agree; each is good to about the square of what the difference from the
# one before shows. Where plain rules do not settle, the integrand has a steep step: split there.
_RUNGS = (
    *(Rule(n, FINE.log_drop) for n in (14, 24, 48, 96)),
    # a panel of 24 nodes would be coarser than the rung before, and agree with it too early
    *(Rule(n, FINE.log_drop, split=True) for n in (48, 96)),
)
_AGREEMENT = 1e-6
_LAST_AGREEMENT = 1e-4
_MAX_RESIDUAL = 1e-3  # of a saddle point that still tells where the mass is
_MAX_TENSOR_DIMENSION = 3
_FEW_STEPS = 4  # of Newton: only the place of fixed nodes hangs on them
_STEP_REACH = 7.0  # standard deviations of a later link: beyond, 1e-12 is left of its step
_SOBOL_SEED = 20170611  # fixed: the same box gives the same bits
_SOBOL_LOG2 = 15  # 8 x 4096 points
_MAX_NUMBERS = 200_000  # in one array of nodes: what the cache holds


@dataclass(frozen=True, slots=True)
class Nodes:
    """Weighted points in the chains of B boxes.

    Attributes
    ----------
    points : ndarray (B, n, d - 1)
        All links but the last.
    lower, upper : ndarray (B, n)
        The interval of the last link, which is standard normal on it.
    log_weight : ndarray (B, n)
        Log of weight times density, the probability of the last link included.
    """

    points: FloatArray
    lower: FloatArray
    upper: FloatArray
    log_weight: FloatArray

    def log_probability(self) -> FloatArray:
        """Log probability (B,) of the boxes."""
        top = self.log_weight.max(axis=1)
        return np.asarray(top + np.log(np.exp(self.log_weight - top[:, None]).sum(axis=1)))

    def take(self, boxes: IntArray | BoolArray) -> "Nodes":
        """The nodes of some boxes."""
        return Nodes(
            self.points[boxes], self.lower[boxes], self.upper[boxes], self.log_weight[boxes]
        )

    def shares(self) -> FloatArray:
        """Weights (B, n) that sum to one in each box."""
        weights = np.exp(self.log_weight - self.log_weight.max(axis=1, keepdims=True))
        return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def tensor_nodes(chain: Chain, tilting: Tilting, rule: Rule) -> Nodes:
    """Tensor Gauss-Legendre nodes on the stretches where the tilted chain has mass.

    The tilted chain dominates the true one up to a constant, so its stretches hold all the mass.
    """
    n_boxes, d = chain.shape
    points = np.empty((n_boxes, 1, 0))
    log_weight = np.zeros((n_boxes, 1))
    for i in range(d - 1):
        shift = np.einsum("bni,bi->bn", points, chain.coupling[:, i, :i])
        shift += tilting.tilt[:, i, None]
        stretch = effective_stretch(
            chain.lower[:, i, None] - shift, chain.upper[:, i, None] - shift, rule.log_drop
        )
        start = tilting.tilt[:, i, None] + stretch.mode
        if rule.split:
            steps = _steps(chain, tilting, points, i)
            stretch = stretch.split(steps - start[..., None])
        offsets, log_step = (v.reshape(*start.shape, -1) for v in stretch.nodes(rule.n))
        z = start[..., None] + offsets
        log_weight = (log_weight[..., None] + log_step - 0.5 * z * z - LOG_SQRT_2PI).reshape(
            n_boxes, -1
        )
        points = np.concatenate(
            [np.repeat(points, z.shape[2], axis=1), z.reshape(n_boxes, -1, 1)], axis=2
        )
    return _close(chain, points, log_weight)


def _steps(chain: Chain, tilting: Tilting, points: FloatArray, i: int) -> FloatArray:
    """Offsets (B, n, m) between which the sides of later links' intervals are passed by.

    Links between are taken at the saddle point. A later link is standard normal, so its
    probability rises over `_STEP_REACH` on both sides of where its mean meets the limit.
    """
    steps = []
    for j in range(i + 1, chain.shape[1]):
        before = np.einsum("bni,bi->bn", points, chain.coupling[:, j, :i])
        between = np.einsum(
            "bk,bk->b", chain.coupling[:, j, i + 1 : j], tilting.point[:, i + 1 : j]
        )
        slope = chain.coupling[:, j, i, None]
        for side in (chain.lower[:, j], chain.upper[:, j]):
            gap = (side - between)[:, None] - before
            for end in (gap - _STEP_REACH, gap + _STEP_REACH):
                far = np.full_like(gap, np.inf)
                steps.append(np.divide(end, slope, out=far, where=slope != 0.0))
    return np.stack(steps, axis=-1)


def sobol_nodes(chain: Chain, tilting: Tilting, log2_points: int = _SOBOL_LOG2) -> Nodes:
    """Scrambled Sobol points mapped through the tilted chain (Botev 2017, eq. 7)."""
    n_boxes, d = chain.shape
    uniform = _sobol(d - 1, log2_points)
    points = np.empty((n_boxes, len(uniform), d - 1))
    log_weight = np.full((n_boxes, len(uniform)), -np.log(len(uniform)))
    for i in range(d - 1):
        tilt = tilting.tilt[:, i, None]
        shift = np.einsum("bni,bi->bn", points[:, :, :i], chain.coupling[:, i, :i]) + tilt
        low, high = chain.lower[:, i, None] - shift, chain.upper[:, i, None] - shift
        z = tilt + quantile(uniform[:, i], low, high)
        log_weight += log_interval_probability(low, high) + tilt * (0.5 * tilt - z)
        points[:, :, i] = z
    return _close(chain, points, log_weight)


def _close(chain: Chain, points: FloatArray, log_weight: FloatArray) -> Nodes:
    """Nodes with the last link's interval and probability."""
    shift = np.einsum("bni,bi->bn", points, chain.coupling[:, -1, :-1])
    lower, upper = chain.lower[:, -1:] - shift, chain.upper[:, -1:] - shift
    return Nodes(points, lower, upper, log_weight + log_interval_probability(lower, upper))


@cache
def _sobol(d: int, log2_points: int) -> FloatArray:
    """Scrambled Sobol points (2 ** log2_points, d), strictly inside the unit cube."""
    from scipy.stats.qmc import Sobol

    points = Sobol(d, scramble=True, seed=_SOBOL_SEED).random_base2(log2_points)
    # The scrambled points lie on a grid that includes 0: the middle of the cell is inside.
    return np.asarray(points + 2.0**-31)


def fixed_nodes(chain: Chain, rule: Rule, log2_points: int) -> Nodes:
    """Nodes of a fixed number, unchecked: for optimisers, which check their answer in the end."""
    tilting = saddle_points(chain, _FEW_STEPS)
    if chain.shape[1] <= _MAX_TENSOR_DIMENSION:
        return tensor_nodes(chain, tilting, rule)
    return sobol_nodes(chain, tilting, log2_points)


def refined_nodes(chain: Chain) -> Iterator[tuple[IntArray, Nodes]]:
    """Groups of boxes with nodes that are accurate for them: (indices (b,), their nodes).

    Raises
    ------
    NumericalError
        If the finest rung still disagrees with the one before.
    """
    tilting = saddle_points(chain)
    n_boxes, d = chain.shape
    pending = np.arange(n_boxes)
    if d > _MAX_TENSOR_DIMENSION:
        for group in _groups(pending, 2**_SOBOL_LOG2 * d):
            yield group, sobol_nodes(chain.take(group), tilting.take(group))
        return
    log_p = np.full(n_boxes, 0.0 if d == 1 else np.nan)  # one link is exact on any rung
    for rule in _RUNGS:
        unsettled = []
        for group in _groups(pending, _n_nodes(rule, d) * d):
            nodes = tensor_nodes(chain.take(group), tilting.take(group), rule)
            new = nodes.log_probability()
            enough = _LAST_AGREEMENT if rule is _RUNGS[-1] else _AGREEMENT
            settled = (np.abs(new - log_p[group]) < enough) | (d == 1)
            settled &= tilting.residual[group] < _MAX_RESIDUAL
            log_p[group] = new
            unsettled.append(group[~settled])
            yield group[settled], nodes.take(settled)
        pending = np.concatenate(unsettled)
        if not len(pending):
            return
    raise NumericalError(
        f"box probability: {len(pending)} of {n_boxes} integrals had not settled with "
        f"{_n_nodes(_RUNGS[-1], d)} nodes; the covariance is close to singular, so drop or "
        "rescale a variable that the others determine."
    )


def _n_nodes(rule: Rule, d: int) -> int:
    """Nodes of a box: of link i, with two panels more for each side of each later link."""
    panels = (1 + 4 * (d - 1 - i) if rule.split else 1 for i in range(d - 1))
    return math.prod(rule.n * n for n in panels)


def _groups(boxes: IntArray, n_numbers: int) -> list[IntArray]:
    """`boxes` in groups whose nodes fit in memory, each box having `n_numbers` of them."""
    size = max(1, _MAX_NUMBERS // n_numbers)
    return [boxes[i : i + size] for i in range(0, max(len(boxes), 1), size)]
