"""The dominating point of every component on the learned inner and outer sets, to draw them."""

from dataclasses import dataclass, replace

import numpy as np

from crashrate.crash_set.order import RiskOrder
from crashrate.sampling.dominating_points import dominating_point
from crashrate.traffic.model import TrafficModel
from crashrate.variables import FloatArray


@dataclass(frozen=True)
class Polyhedron:
    """{x: normals @ x >= offsets}: an orthant of risk coordinates, inside the truncation box."""

    normals: FloatArray
    offsets: FloatArray


@dataclass(frozen=True)
class DominatingPoint:
    """Where one component is densest in a union of orthants.

    Parameters
    ----------
    component : int
        Counted from 1.
    weight : float
        The component's weight in traffic.
    distance : float
        From the component's mean, in its standard deviations.
    x : (d,) array
    """

    component: int
    weight: float
    distance: float
    x: FloatArray


def dominating_points(
    traffic: TrafficModel, order: RiskOrder, corners: FloatArray
) -> tuple[DominatingPoint, ...] | None:
    """Of every component, on the union of the orthants {u(x) >= corner} inside the box (§IV.B).

    Parameters
    ----------
    traffic : TrafficModel
    order : RiskOrder
    corners : (n, m) array
        -inf where a coordinate is not bounded.

    Returns
    -------
    tuple of DominatingPoint, or None
        None where an orthant is not known to be a polyhedron in the variables.
    """
    modelled, order = traffic.modelled, order.on(traffic.scales)
    orthants = [_polyhedron(modelled, order, corner) for corner in corners]
    known = [o for o in orthants if o is not None]
    if len(known) < len(orthants):
        return None
    found = (_nearest(modelled, k, known) for k in range(len(traffic.weights)))
    return tuple(
        replace(point, x=traffic.from_modelled(point.x[None])[0])
        for point in found
        if point is not None
    )


def _polyhedron(traffic: TrafficModel, order: RiskOrder, corner: FloatArray) -> Polyhedron | None:
    d = len(traffic.names)
    normals = [np.eye(d), -np.eye(d)]
    offsets = [np.asarray(traffic.lower), -np.asarray(traffic.upper)]
    for k in np.flatnonzero(np.isfinite(corner)):
        half_space = order.half_space(int(k), float(corner[k]), traffic.lower, traffic.upper)
        if half_space is None:
            return None
        normals.append(np.reshape(half_space.normal, (1, d)))
        offsets.append(np.reshape(half_space.offset, 1))
    return Polyhedron(np.vstack(normals), np.concatenate(offsets))


def _nearest(traffic: TrafficModel, k: int, orthants: list[Polyhedron]) -> DominatingPoint | None:
    mean, covariance = traffic.means[k], traffic.covariances[k]
    bounds = [_distance_bound(mean, covariance, o) for o in orthants]
    best, best_x = np.inf, None
    # the nearest half-space bounds the distance from below: most orthants need no solving
    for i in np.argsort(bounds, kind="stable"):
        if bounds[i] >= best:
            break
        x = dominating_point(mean, covariance, orthants[i].normals, orthants[i].offsets)
        if x is None:
            continue
        distance = float(np.sqrt((x - mean) @ np.linalg.solve(covariance, x - mean)))
        if distance < best:
            best, best_x = distance, x
    if best_x is None:
        return None
    return DominatingPoint(k + 1, float(traffic.weights[k]), best, best_x)


def _distance_bound(mean: FloatArray, covariance: FloatArray, orthant: Polyhedron) -> float:
    """Distance to the farthest of the half-spaces that make the orthant."""
    normals, offsets = orthant.normals, orthant.offsets
    spread = np.sqrt(np.einsum("ij,jk,ik->i", normals, covariance, normals))
    missing = np.where(np.isfinite(offsets), offsets - normals @ mean, -np.inf)
    return float(np.max(missing / spread, initial=0.0))
