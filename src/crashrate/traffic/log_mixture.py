"""Log densities of Gaussian mixtures at many rows: one matrix product and one power per block.

Component k at y = x - shift is 2^t_k, its t_k being linear in (1, y, y y'): a block of rows costs
a product of matrices, K powers of two a row (cheaper than exponentials) and a sum. No maximum is
subtracted first: t_k never exceeds 0, the highest peak of all components, and the rare row where
even the largest t_k would underflow is done again with its own maximum.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt

from crashrate.traffic.compiled import compiled_totals
from crashrate.variables import FloatArray, frozen

_LN2 = float(np.log(2.0))
_LOG_NOTHING = -1e300  # log 0 as a number: an infinite one makes invalid values in a product
# powers of two below the first are slow, for they are not normal numbers: raised to it, they are
# still nothing beside a sum above the second
_LOWEST = -1000.0
_LEAST_SUM = 2.0**-900
# Terms of an expanded square that add up to this much leave an error of about 1e-12 when they
# cancel: where they are larger _REACH scales from the centre, the square is computed unexpanded.
_LARGEST_TERMS = 1e4
_REACH = 5.0
# multiply-adds of a block's product: OpenBLAS takes such small ones without copying them first
_PRODUCT = 700_000
_MIN_BLOCK, _MAX_BLOCK = 128, 8000


class Block(NamedTuple):
    """A block of rows; the arrays are overwritten by the next."""

    rows: slice
    powers: FloatArray  # (K, n): the components' densities in a unit common to each row
    totals: FloatArray  # (n,): their sums
    logs: FloatArray  # (n,): log density of the mixture


@dataclass(frozen=True, eq=False)
class LogMixture:
    """log Σ_k w_k N(x; m_k, C_k) / P_k, ready to be evaluated; build it with :meth:`of`.

    Attributes
    ----------
    shift : ndarray (d,)
        Origin of y.
    top : float
        Log of the highest peak of a component.
    peaks : ndarray (K,)
        Peaks of t_k.
    roots : ndarray (K, d, 1 + d)
        t_k = peak - |root (1, y)|².
    table : ndarray (K, n_features)
        Coefficients of t_k in the features of y.
    stiff : ndarray (S,)
        Components whose coefficients are so large that they would cancel: t_k by its root.
    """

    shift: FloatArray
    top: float
    peaks: FloatArray
    roots: FloatArray
    table: FloatArray
    stiff: npt.NDArray[np.int64]

    @classmethod
    def of(
        cls,
        weights: FloatArray,
        log_masses: FloatArray,
        means: FloatArray,
        covariances: FloatArray,
        *,
        shift: FloatArray,
        scale: FloatArray,
    ) -> Self:
        """The mixture with weights (K,), log P (K,), means (K, d) and covariances (K, d, d).

        `shift` and `scale` (d,) are about where rows will lie: there the rounding is least.
        """
        d = len(scale)
        factors = np.linalg.cholesky(covariances / np.outer(scale, scale))
        inverse = np.linalg.solve(factors, np.broadcast_to(np.eye(d), factors.shape))
        log_root = np.log(np.diagonal(factors, axis1=1, axis2=2)).sum(axis=1)
        log_weights = np.log(weights, out=np.full(len(weights), _LOG_NOTHING), where=weights > 0.0)
        peaks = log_weights - log_masses - log_root
        top = float(peaks.max())
        centres = (means - shift) / scale
        offsets = np.einsum("kij,kj->ki", inverse, centres)
        precisions = np.einsum("kji,kjl->kil", inverse, inverse)
        i, j = _pairs(d)
        linear = np.einsum("kij,kj->ki", precisions, centres)
        constant = -0.5 * np.einsum("ki,ki->k", offsets, offsets)
        products = precisions[:, i, j] * np.where(i == j, -0.5, -1.0)
        square = np.hstack([constant[:, None], linear, products])
        table = square / (_LN2 * _features(scale))
        table[:, 0] += (peaks - top) / _LN2
        sizes = np.abs(square) @ _features(np.full(d, _REACH))
        roots = np.concatenate([-offsets[:, :, None], inverse / scale], axis=2)
        return cls(
            shift=frozen(shift),
            top=top - 0.5 * d * float(np.log(2.0 * np.pi)) - float(np.log(scale).sum()),
            peaks=frozen((peaks - top) / _LN2),
            roots=frozen(roots * np.sqrt(0.5 / _LN2)),
            table=frozen(table),
            stiff=frozen(np.flatnonzero(sizes > _LARGEST_TERMS), np.int64),
        )

    def log_density(self, x: FloatArray, *, fast: bool = False) -> FloatArray:
        """Log density at rows x (n, d), shape (n,).

        Parameters
        ----------
        x : ndarray, shape (n, d)
        fast : bool
            By the compiled kernel of `crashrate[fast]`. It agrees to about 1e-13, but not in
            every bit: what decides anything in a campaign is computed without.

        Raises
        ------
        MissingExtraError
            If `fast` and the extra is not installed.
        """
        totals = np.empty(len(x))
        if fast:
            kernel = compiled_totals(len(self.shift))
            kernel(np.ascontiguousarray(x), self.shift, self.peaks, self.roots, totals)
        else:
            self._sum_powers(x, totals)
        far = np.flatnonzero(totals < _LEAST_SUM)
        out = np.log(totals, out=totals)
        out += self.top
        if len(far):
            out[far] = self._far(x[far]).logs
        return out

    def log_terms(self, x: FloatArray) -> FloatArray:
        """Log of each component's part of the density at rows x (n, d), shape (n, K)."""
        out = np.empty((len(self.peaks), len(x)))
        for rows, terms in self._block_terms(x):
            np.multiply(terms, _LN2, out=out[:, rows])
        out += self.top
        return out.T

    def shares(self, x: FloatArray) -> FloatArray:
        """Probability that each of the rows x (n, d) came from each component, shape (n, K)."""
        out = np.empty((len(self.peaks), len(x)))
        for block in self.blocks(x):
            np.divide(block.powers, block.totals, out=out[:, block.rows])
        return out.T

    def blocks(self, x: FloatArray) -> Iterator[Block]:
        """Rows x (n, d) in blocks that stay in the cache."""
        for rows, terms in self._block_terms(x):
            powers = _powers(terms)
            totals = powers.sum(axis=0)
            block = Block(rows, powers, totals, np.log(totals) + self.top)
            far = np.flatnonzero(totals < _LEAST_SUM)
            if len(far):
                parts = self._far(x[rows][far])
                powers[:, far], totals[far], block.logs[far] = parts[1:]
            yield block

    def _sum_powers(self, x: FloatArray, out: FloatArray) -> None:
        """Σ_k 2^t_k at rows x (n, d), into `out` (n,)."""
        ones = np.ones(len(self.peaks))
        for rows, terms in self._block_terms(x):
            np.matmul(ones, _powers(terms), out=out[rows])

    def _block_terms(self, x: FloatArray) -> Iterator[tuple[slice, FloatArray]]:
        """Blocks of about equal size, and their t (K, n)."""
        most = min(max(_PRODUCT // self.table.size, _MIN_BLOCK), _MAX_BLOCK)
        size = _stride(len(x) // (len(x) // most + 1))
        room = self._room(size)
        for start in range(0, len(x), size):
            rows = slice(start, min(start + size, len(x)))
            if rows.stop - start < size:
                room = self._room(rows.stop - start)
            yield rows, self._terms(x[rows], room)

    def _room(self, n: int) -> "_Room":
        return _Room.of(n, len(self.shift), len(self.peaks))

    def _far(self, x: FloatArray) -> Block:
        """Rows x (n, d) where every 2^t would underflow: powers of t less its largest."""
        terms = self._terms(x, self._room(len(x)))
        largest = terms.max(axis=0)
        powers = _powers(terms - largest)
        totals = powers.sum(axis=0)
        logs = np.log(totals) + (largest * _LN2 + self.top)
        return Block(slice(0, len(x)), powers, totals, logs)

    def _terms(self, x: FloatArray, room: "_Room") -> FloatArray:
        """t (K, n) at rows x (n, d), which are as many as there is room for."""
        np.subtract(x.T, self.shift[:, None], out=room.y)
        for one, other, product in room.products:
            np.multiply(one, other, out=product)
        np.matmul(self.table, room.features, out=room.terms)
        if len(self.stiff):
            d = len(self.shift)
            roots = self.roots[self.stiff].reshape(-1, 1 + d) @ room.features[: 1 + d]
            roots *= roots
            squares = roots.reshape(len(self.stiff), d, -1).sum(axis=1)
            room.terms[self.stiff] = self.peaks[self.stiff, None] - squares
        return room.terms


@dataclass(frozen=True, slots=True, eq=False)
class _Room:
    """Arrays for the features (n_features, n) and terms (K, n) of a block, and views of them."""

    features: FloatArray
    terms: FloatArray
    y: FloatArray
    products: list[tuple[FloatArray, FloatArray, FloatArray]]

    @classmethod
    def of(cls, n: int, d: int, n_components: int) -> Self:
        """Room for n rows of d variables."""
        stride = _stride(n)
        features = np.empty((1 + d + d * (d + 1) // 2, stride))[:, :n]
        features[0] = 1.0
        y, products, first = features[1 : 1 + d], [], 1 + d
        for lag in range(d):  # y_i y_(i+lag) of all i in one go
            products.append((y[: d - lag], y[lag:], features[first : first + d - lag]))
            first += d - lag
        return cls(features, np.empty((n_components, stride))[:, :n], y, products)


def _stride(n: int) -> int:
    """At least n numbers, odd in cache lines: rows 4096 bytes apart evict one another."""
    return (n + 7) // 16 * 16 + 8


def _pairs(d: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Indices i <= j of the products y_i y_j, by their distance j - i."""
    i = np.concatenate([np.arange(d - lag) for lag in range(d)])
    j = np.concatenate([np.arange(lag, d) for lag in range(d)])
    return i, j


def _features(y: FloatArray) -> FloatArray:
    """1, y and the products of one row y (d,)."""
    i, j = _pairs(len(y))
    return np.concatenate([[1.0], y, y[i] * y[j]])


def _powers(terms: FloatArray) -> FloatArray:
    """2^t of terms t (K, n), in their place."""
    if np.minimum.reduce(terms, axis=None) < _LOWEST:
        np.maximum(terms, _LOWEST, out=terms)
    return np.exp2(terms, out=terms)
