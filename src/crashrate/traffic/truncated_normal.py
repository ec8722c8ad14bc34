"""The normal law on a box: probability, first two moments and exact draws.

Everything is worked in logarithms and summed from positive terms, so the accuracy is relative:
a box of probability 1e-260 has as many correct digits as one of 0.5. Up to three bounded
variables the integrals are deterministic quadratures (about 1e-10); beyond that they are
quasi-Monte Carlo over the tilted chain with fixed points (about 1e-5).
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from crashrate.errors import InvalidInputError
from crashrate.traffic.one_dimension import IntervalMoments, interval_moments
from crashrate.traffic.quadrature import Nodes, refined_nodes
from crashrate.traffic.sampling import sample_truncated
from crashrate.traffic.tilting import Chain, chains
from crashrate.variables import FloatArray

__all__ = ["BoxMoments", "box_moments", "log_box_probability", "sample_truncated"]


@dataclass(frozen=True, slots=True)
class BoxMoments:
    """Probability of boxes under normals, and the moments of those normals on them.

    Attributes
    ----------
    log_probability : ndarray (B,)
        Log probability of the box under the untruncated normal.
    mean : ndarray (B, d)
        Mean of the normal truncated to the box.
    covariance : ndarray (B, d, d)
        Its covariance, positive definite.
    """

    log_probability: FloatArray
    mean: FloatArray
    covariance: FloatArray


def log_box_probability(
    means: npt.ArrayLike, covariances: npt.ArrayLike, lower: npt.ArrayLike, upper: npt.ArrayLike
) -> FloatArray:
    """Log probability of boxes under normals.

    Parameters
    ----------
    means : array_like (B, d) or (d,)
    covariances : array_like (B, d, d) or (d, d)
    lower, upper : array_like (B, d) or (d,)
        Sides of the boxes, infinite where there is none. Single ones serve the whole batch.

    Returns
    -------
    ndarray (B,)

    Raises
    ------
    InvalidInputError
        If shapes do not fit, or a box has lower >= upper.
    NumericalError
        If a covariance is singular to working precision.
    """
    _, _, chain = _batch(means, covariances, lower, upper)
    out = np.empty(chain.shape[0])
    for boxes, nodes in refined_nodes(chain.head(max(1, chain.n_bounded()))):
        out[boxes] = nodes.log_probability()
    return out


def box_moments(
    means: npt.ArrayLike, covariances: npt.ArrayLike, lower: npt.ArrayLike, upper: npt.ArrayLike
) -> BoxMoments:
    """Probability, mean and covariance of normals on boxes, from the same nodes.

    Parameters, shapes and errors are those of :func:`log_box_probability`. These are the moments
    M1 and M2 of the paper's eqs. 7 and 8, the second taken about the mean.
    """
    means_, _, chain = _batch(means, covariances, lower, upper)
    n_boxes, d = chain.shape
    log_p = np.empty(n_boxes)
    z_mean, z_covariance = np.zeros((n_boxes, d)), np.tile(np.eye(d), (n_boxes, 1, 1))
    n = max(1, chain.n_bounded())  # the links after these are free: standard normal
    for boxes, nodes in refined_nodes(chain.head(n)):
        log_p[boxes] = nodes.log_probability()
        z_mean[boxes, :n], z_covariance[boxes, :n, :n] = chain_moments(
            nodes, interval_moments(nodes.lower, nodes.upper)
        )
    return BoxMoments(log_p, *from_chain(chain, means_, z_mean, z_covariance))


def chain_moments(nodes: Nodes, last: IntervalMoments) -> tuple[FloatArray, FloatArray]:
    """Mean (B, d) and covariance (B, d, d) of the links, given the `last` one's at the nodes."""
    shares = nodes.shares()
    z = np.concatenate([nodes.points, last.mean[..., None]], axis=2)
    mean = np.einsum("bn,bni->bi", shares, z)
    centred = z - mean[:, None, :]
    covariance = (centred * shares[..., None]).transpose(0, 2, 1) @ centred
    covariance[:, -1, -1] += (shares * last.second).sum(axis=1)  # total variance of the last
    return mean, covariance


def from_chain(
    chain: Chain, means: FloatArray, z_mean: FloatArray, z_covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Mean and covariance of the variables from those of the links: x = mean + factor z."""
    rows = placed_factor(chain)
    mean = means + np.einsum("bij,bj->bi", rows, z_mean)
    covariance = rows @ z_covariance @ rows.transpose(0, 2, 1)
    return mean, 0.5 * (covariance + covariance.transpose(0, 2, 1))


def placed_factor(chain: Chain) -> FloatArray:
    """The factor (B, d, d) with its rows back in the order of the variables."""
    rows = np.empty_like(chain.factor)
    np.put_along_axis(rows, chain.order[:, :, None], chain.factor, axis=1)
    return rows


def _batch(
    means: npt.ArrayLike, covariances: npt.ArrayLike, lower: npt.ArrayLike, upper: npt.ArrayLike
) -> tuple[FloatArray, FloatArray, Chain]:
    """Means (B, d), covariances (B, d, d) and the chains of the boxes, checked."""
    m, low, high = (np.atleast_2d(np.asarray(v, float)) for v in (means, lower, upper))
    c = np.asarray(covariances, float)
    c = c[None] if c.ndim == 2 else c
    d = m.shape[-1]
    try:
        n_boxes = np.broadcast_shapes(m.shape, low.shape, high.shape, (*c.shape[:1], d))[0]
        m, low, high = (np.broadcast_to(v, (n_boxes, d)) for v in (m, low, high))
        c = np.broadcast_to(c, (n_boxes, d, d))
    except ValueError:
        raise InvalidInputError(
            "expected means (B, d), covariances (B, d, d), lower (B, d) and upper (B, d), or "
            f"single ones; got {m.shape}, {c.shape}, {low.shape} and {high.shape}."
        ) from None
    _check_numbers(m, c, low, high)
    return m, c, chains(c, low - m, high - m)


def _check_numbers(m: FloatArray, c: FloatArray, low: FloatArray, high: FloatArray) -> None:
    """Refuse means and covariances that are not finite, and empty boxes."""
    if not (np.isfinite(m).all() and np.isfinite(c).all()):
        raise InvalidInputError("means and covariances: expected finite numbers, got nan or inf.")
    empty = np.argwhere(~(low < high))
    if len(empty):
        box, side = (int(i) for i in empty[0])
        raise InvalidInputError(
            f"box {box}, variable {side}: expected lower < upper, got lower = "
            f"{low[box, side]} and upper = {high[box, side]}."
        )
