"""Directions of traffic in which no risk coordinate changes: an order is blind to what lies there.

Variables that no coordinate depends on are such directions; so is a - b where the order knows a + b
alone, and b where it knows max(b, 2) and b is seldom above. The order claims that nothing depends
on them.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import qr, solve_triangular

from crashrate.crash_set.order import RiskOrder
from crashrate.traffic.model import TrafficModel
from crashrate.variables import FloatArray

N_TRIED, FAR = 256, 3.0  # draws, and the same so many times as far out
# Of secants, in standard deviations. Where a coordinate is flat by the short one, as if it were
# rounded, the long one counts.
SHORT, LONG = 0.001, 0.5
INDEPENDENT = 0.05  # least singular value of unit slopes that tell directions apart
OFTEN = 0.15  # a direction counts that is unseen in this share of situations


@dataclass(frozen=True, eq=False)
class Blind:
    """k directions of d variables that an order does not see.

    Parameters
    ----------
    ways : ndarray, shape (d, k)
        In the variables' own units.
    center : ndarray, shape (d,)
        The middle from which displacements are told.
    factor : ndarray, shape (d, d)
        Lower triangular, of a covariance: the units that they are told in.
    """

    ways: FloatArray
    center: FloatArray
    factor: FloatArray

    @classmethod
    def of(cls, order: RiskOrder, traffic: TrafficModel) -> "Blind":
        """What `order` does not see of `traffic`: by secants at draws of it, and far out."""
        factor = _cholesky(traffic.covariance)
        return cls(factor @ _unseen(_slopes(order, traffic) @ factor), traffic.mean, factor)

    def within(self, mean: FloatArray, covariance: FloatArray) -> "Blind":
        """The same directions in the units of one of traffic's components."""
        return Blind(self.ways, mean, _cholesky(covariance))

    @property
    def n(self) -> int:
        """Number k of directions."""
        return int(self.ways.shape[1])

    @cached_property
    def directions(self) -> FloatArray:
        """Orthonormal in standard units, (d, k), along their axes where it can be."""
        basis = np.linalg.qr(solve_triangular(self.factor, self.ways, lower=True))[0]
        return np.asarray(qr(basis @ basis.T, pivoting=True)[0][:, : self.n])

    def displaced(self, x: FloatArray) -> FloatArray:
        """How far situations (n, d) lie from the middle along each of the directions, (n, k)."""
        z = solve_triangular(self.factor, (x - self.center).T, lower=True).T
        return np.asarray(z @ self.directions)

    def undone(self, x: FloatArray) -> FloatArray:
        """Each situation (n, d) moved to the middle along all directions, and along each alone.

        Shape (n, 1 + k, d).
        """
        steps = self.displaced(x)[:, None] * np.concatenate([np.ones((1, self.n)), np.eye(self.n)])
        return np.asarray(x[:, None] - steps @ self.directions.T @ self.factor.T)


def _cholesky(covariance: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)


def _slopes(order: RiskOrder, traffic: TrafficModel) -> FloatArray:
    """Slopes (n, m, d) of the risk coordinates, those that are finite."""
    usual = traffic.sample(N_TRIED, np.random.default_rng(0))
    far = traffic.mean + FAR * (usual - traffic.mean)  # a coordinate may be level where crashes are
    x = np.concatenate([usual, _inside(far, usual, traffic)])
    short, long = (_secants(order, traffic, x, step) for step in (SHORT, LONG))
    flat = ~short.any(axis=2, keepdims=True)
    slopes = np.where(flat, long, short)
    return np.asarray(slopes[np.isfinite(slopes).all(axis=(1, 2))])


def _secants(order: RiskOrder, traffic: TrafficModel, x: FloatArray, step: float) -> FloatArray:
    """Slopes (n, m, d) at `x` (n, d) over a `step`, inside traffic's box."""
    slopes = np.empty((len(x), order.n_coordinates, x.shape[1]))
    for i, size in enumerate(step * np.sqrt(np.diagonal(traffic.covariance))):
        low, high = x.copy(), x.copy()
        low[:, i] -= size
        high[:, i] += size
        low, high = _inside(low, x, traffic), _inside(high, x, traffic)
        for k in range(order.n_coordinates):
            rise = order.coordinate(k, high) - order.coordinate(k, low)
            slopes[:, k, i] = rise / (high[:, i] - low[:, i])
    return slopes


def _inside(x: FloatArray, start: FloatArray, traffic: TrafficModel) -> FloatArray:
    """`x` (n, d), where it is outside traffic's box half way to the bound, from `start` inside.

    (A coordinate over a range may be infinite on the bound itself.)
    """
    bound = np.clip(x, traffic.lower, traffic.upper)
    return np.where(x == bound, x, (start + bound) / 2)


def _unseen(slopes: FloatArray) -> FloatArray:
    """Orthonormal directions (d, k) that slopes (n, m, d) often do not see."""
    size = np.linalg.norm(slopes, axis=2, keepdims=True)
    unit = np.divide(slopes, size, out=np.zeros_like(slopes), where=size > 0)
    _, values, rows = np.linalg.svd(unit, full_matrices=False)
    seen = rows * (values > INDEPENDENT)[:, :, None]
    of_situations = np.einsum("nri,nrj->ij", seen, seen) / max(len(seen), 1)
    shares, axes = np.linalg.eigh(np.eye(slopes.shape[2]) - of_situations)
    return np.asarray(axes[:, shares > OFTEN])
