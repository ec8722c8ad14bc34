"""Exact draws from a normal truncated to a box."""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from crashrate.errors import InvalidInputError, NumericalError
from crashrate.traffic.one_dimension import log_interval_probability, quantile
from crashrate.traffic.tilting import Chain, Tilting, chains, saddle_points
from crashrate.variables import FloatArray

# Below this bound of the box probability the tilted chain is faster than plain rejection.
_PLAIN_BELOW = math.log(0.2)
_BLOCK = 65_536
_MIN_ACCEPTANCE = 1e-6
_MAX_RESIDUAL = 1e-6


def sample_truncated(  # noqa: PLR0917 - a law, a box, a number and a generator
    mean: npt.ArrayLike,
    covariance: npt.ArrayLike,
    lower: npt.ArrayLike,
    upper: npt.ArrayLike,
    n: int,
    rng: np.random.Generator,
) -> FloatArray:
    """Independent draws of a normal truncated to a box.

    Plain rejection where the box is likely, else the accept-reject method of Botev (2017,
    algorithm 1), exact at any probability of the box.

    Parameters
    ----------
    mean : array_like (d,)
    covariance : array_like (d, d)
    lower, upper : array_like (d,)
        Sides of the box, infinite where there is none.
    n : int
        Number of draws.
    rng : numpy.random.Generator

    Returns
    -------
    ndarray (n, d)

    Raises
    ------
    InvalidInputError
        If n is negative, shapes do not fit, or the box is empty.
    NumericalError
        If the covariance is singular to working precision, or too close to it to draw.
    """
    m, low, high = (np.asarray(v, float) for v in (mean, lower, upper))
    c = np.asarray(covariance, float)
    _check(m, c, low, high, n)
    return TruncatedNormals.of(m[None], c[None], low, high).sample(0, n, rng)


@dataclass(frozen=True, eq=False)
class TruncatedNormals:
    """B normals truncated to one box, their saddle points found once for all draws.

    Parameters
    ----------
    means : ndarray (B, d)
    lower, upper : ndarray (d,)
    chain : Chain
    tilting : Tilting
    """

    means: FloatArray
    lower: FloatArray
    upper: FloatArray
    chain: Chain
    tilting: Tilting

    @classmethod
    def of(
        cls, means: FloatArray, covariances: FloatArray, lower: FloatArray, upper: FloatArray
    ) -> Self:
        """The laws with means (B, d) and covariances (B, d, d)."""
        chain = chains(covariances, lower - means, upper - means)
        return cls(means, lower, upper, chain, saddle_points(chain))

    def sample(self, b: int, n: int, rng: np.random.Generator) -> FloatArray:
        """Independent draws (n, d) of law b; see :func:`sample_truncated`."""
        mean, one = self.means[b], np.array([b])
        chain, tilting = self.chain.take(one), self.tilting.take(one)
        plain = bool(tilting.log_bound[0] > _PLAIN_BELOW)
        if not plain and tilting.residual[0] > _MAX_RESIDUAL:
            raise NumericalError(
                "truncated draws: the saddle point was not found (residual "
                f"{tilting.residual[0]:.1e}); the covariance is close to singular, so drop or "
                "rescale a variable."
            )
        z = _collect(chain, tilting, n, rng, plain=plain)
        x = np.empty((n, len(mean)))
        x[:, chain.order[0]] = mean[chain.order[0]] + z @ chain.factor[0].T
        # mean + factor z rounds: a draw a hair outside the box belongs on its side.
        return np.clip(x, self.lower, self.upper)


def _check(m: FloatArray, c: FloatArray, low: FloatArray, high: FloatArray, n: int) -> None:
    """Refuse shapes that do not fit, an empty box and a negative number of draws."""
    d = m.size
    if m.shape != (d,) or c.shape != (d, d) or low.shape != (d,) or high.shape != (d,):
        raise InvalidInputError(
            "expected mean (d,), covariance (d, d), lower (d,) and upper (d,); "
            f"got {m.shape}, {c.shape}, {low.shape} and {high.shape}."
        )
    if not (low < high).all():
        raise InvalidInputError(f"box: expected lower < upper, got {low} and {high}.")
    if n < 0:
        raise InvalidInputError(f"n: expected a number of draws >= 0, got {n}.")


def _collect(
    chain: Chain, tilting: Tilting, n: int, rng: np.random.Generator, *, plain: bool
) -> FloatArray:
    """n accepted z (n, d), from blocks sized by the acceptance seen so far."""
    propose = _plain_block if plain else _tilted_block
    accepted: list[FloatArray] = [np.empty((0, chain.shape[1]))]
    n_accepted = n_proposed = 0
    while n_accepted < n:
        rate = (n_accepted + 1.0) / (n_proposed + 2.0)
        if rate < _MIN_ACCEPTANCE:
            raise NumericalError(
                f"truncated draws: {n_accepted} of {n_proposed} proposals accepted; the "
                "covariance is close to singular, so drop or rescale a variable."
            )
        size = int(min(_BLOCK, 1.05 * (n - n_accepted) / rate + 16.0))
        block = propose(chain, tilting, size, rng)
        accepted.append(block)
        n_accepted += len(block)
        n_proposed += size
    return np.concatenate(accepted)[:n]


def _plain_block(chain: Chain, tilting: Tilting, size: int, rng: np.random.Generator) -> FloatArray:
    """Standard normals (m, d) that fell in the box."""
    del tilting
    z = rng.standard_normal((size, chain.shape[1]))
    reach = z + z @ chain.coupling[0].T
    inside = ((reach >= chain.lower[0]) & (reach <= chain.upper[0])).all(axis=1)
    return np.asarray(z[inside])


def _tilted_block(
    chain: Chain, tilting: Tilting, size: int, rng: np.random.Generator
) -> FloatArray:
    """Draws (m, d) of the tilted chain, accepted with probability exp(psi - bound)."""
    d = chain.shape[1]
    z = np.empty((size, d))
    log_ratio = np.zeros(size)
    for i in range(d):
        tilt = tilting.tilt[0, i]
        shift = z[:, :i] @ chain.coupling[0, i, :i] + tilt
        low, high = chain.lower[0, i] - shift, chain.upper[0, i] - shift
        z[:, i] = tilt + quantile(rng.random(size), low, high)
        log_ratio += log_interval_probability(low, high) + tilt * (0.5 * tilt - z[:, i])
    accepted = -rng.standard_exponential(size) < log_ratio - tilting.log_bound[0]
    return np.asarray(z[accepted])
