"""Directions of traffic in which no risk coordinate changes: an order is blind to what lies there.

Variables that no coordinate depends on are such directions; so is a - b where the order knows a + b
alone. The order claims that nothing depends on them.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr, solve_triangular

from crashrate.crash_set.order import RiskOrder
from crashrate.traffic.model import TrafficModel
from crashrate.variables import FloatArray

N_TRIED = 256
STEP = 0.5  # of the secants, in standard deviations: steps of a coordinate are seen by most of them
INDEPENDENT = 1e-6  # least singular value of coordinates that tell directions apart
OFTEN = 0.15  # share of situations in which a direction is blind to count as one


@dataclass(frozen=True, eq=False)
class Blind:
    """k directions of d variables that an order does not see.

    Parameters
    ----------
    directions : ndarray, shape (d, k)
        Orthonormal, in standard units of traffic.
    center : ndarray, shape (d,)
    factor : ndarray, shape (d, d)
        Lower triangular: one of traffic's covariance.
    """

    directions: FloatArray
    center: FloatArray
    factor: FloatArray

    @classmethod
    def of(cls, order: RiskOrder, traffic: TrafficModel) -> "Blind":
        """What `order` does not see of `traffic`: by secants at draws of it."""
        factor = np.asarray(np.linalg.cholesky(traffic.covariance), dtype=np.float64)
        slopes = _slopes(order, traffic) @ factor
        return cls(_aligned(_null_space(slopes)), traffic.mean, factor)

    @property
    def n(self) -> int:
        """Number k of directions."""
        return int(self.directions.shape[1])

    def displaced(self, x: FloatArray) -> FloatArray:
        """How far situations (n, d) lie from the middle of traffic along each of them, (n, k)."""
        z = solve_triangular(self.factor, (x - self.center).T, lower=True).T
        return np.asarray(z @ self.directions)

    def undone(self, x: FloatArray) -> FloatArray:
        """Situations (n, d) moved to the middle along these directions alone."""
        return np.asarray(x - self.displaced(x) @ self.directions.T @ self.factor.T)


def _slopes(order: RiskOrder, traffic: TrafficModel) -> FloatArray:
    """Slopes (n, m, d) of the risk coordinates, by secants inside traffic's box."""
    x = traffic.sample(N_TRIED, np.random.default_rng(0))
    columns = []
    for i, step in enumerate(STEP * np.sqrt(np.diagonal(traffic.covariance))):
        low, high = x.copy(), x.copy()
        low[:, i] = np.maximum(x[:, i] - step, traffic.lower[i])
        high[:, i] = np.minimum(x[:, i] + step, traffic.upper[i])
        run = high[:, i] - low[:, i]
        columns.append(
            [
                (order.coordinate(k, high) - order.coordinate(k, low)) / run
                for k in range(order.n_coordinates)
            ]
        )
    slopes = np.moveaxis(np.array(columns), (0, 1, 2), (2, 1, 0))
    return np.asarray(slopes[np.isfinite(slopes).all(axis=(1, 2))])


def _null_space(slopes: FloatArray) -> FloatArray:
    """Projector (d, d) on directions that slopes (n, m, d) do not see, where they see the most."""
    d = slopes.shape[2]
    size = np.linalg.norm(slopes, axis=2, keepdims=True)
    unit = np.divide(slopes, size, out=np.zeros_like(slopes), where=size > 0)
    _, values, rows = np.linalg.svd(unit)
    ranks = (values > INDEPENDENT).sum(axis=1)
    most = int(ranks.max(initial=0))
    seen = rows[ranks == most, :most]
    blind = np.eye(d) - (np.einsum("nri,nrj->ij", seen, seen) / max(len(seen), 1))
    shares, axes = np.linalg.eigh(blind)
    kept = axes[:, shares > OFTEN] if most < d else axes[:, :0]
    return np.asarray(kept @ kept.T)


def _aligned(projector: FloatArray) -> FloatArray:
    """Orthonormal directions (d, k) of the space of `projector`, axes where it has any."""
    k = round(float(np.trace(projector)))
    return np.asarray(qr(projector, pivoting=True)[0][:, :k])
