"""What a benchmark problem is, and the traffic models that most of them share."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from braking_follower import Outcomes, Rows
from crashrate.traffic.model import TrafficModel


@dataclass(frozen=True)
class Benchmark:
    """A crash set under a traffic model.

    Parameters
    ----------
    traffic : TrafficModel
    risk : mapping or None
        The risk order declared to the campaign.
    crash : callable
        Rows (n, d) to outcomes (n,).
    probability : float
        The reference.
    margin : callable or None
        Rows (n, d) to numbers (n,) that are zero or below in a crash, and as smooth as the problem
        allows: what the methods of `calls.py` that need more than an outcome are given.
    """

    traffic: TrafficModel
    risk: Mapping[str, Any] | None
    crash: Callable[[Rows], Outcomes]
    probability: float
    margin: Callable[[Rows], Rows] | None = None


def mixture(
    weights: npt.ArrayLike, means: npt.ArrayLike, covariances: npt.ArrayLike, lower: float = -np.inf
) -> TrafficModel:
    """A mixture of variables x1, x2, … with the same lower bound and no upper one."""
    d = np.shape(means)[1]
    names = tuple(f"x{i + 1}" for i in range(d))
    return TrafficModel(weights, means, covariances, [lower] * d, [np.inf] * d, names)


def standard_normal(d: int) -> TrafficModel:
    """d independent standard normals."""
    return mixture([1.0], np.zeros((1, d)), np.eye(d)[None])


def order_of(traffic: TrafficModel, *directions: str) -> dict[str, str]:
    """The risk order with one direction a variable."""
    return dict(zip(traffic.names, directions, strict=True))
