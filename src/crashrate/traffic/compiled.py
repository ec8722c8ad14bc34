"""The sum of a mixture's powers of two, compiled by numba: what `crashrate[fast]` brings.

One loop computes squares, powers and sums of a few hundred rows that stay in the nearest cache;
numba makes it a loop over eight rows at a time where the processor can.
"""

from collections.abc import Callable
from functools import cache
from importlib import import_module
from types import ModuleType

import numpy as np

from crashrate.errors import MissingExtraError

_WIDTH = 256  # rows at a time
_LOWEST = -1000.0  # 2^t below it is nothing, and would wrap the exponent
# Added to t, this leaves round(t) + 1023 in the low bits: those of a number's exponent, in place
# once shifted past the 52 of its fraction.
_ROUNDING = 1.5 * 2.0**52 + 1023.0
_FRACTION = 52
_DEGREE = 9  # of the polynomial for 2^r on [-1/2, 1/2]; off by 1e-14 at most


@cache
def compiled_totals(d: int) -> Callable[..., None]:
    """The kernel for d variables: totals(x, shift, peaks, roots, out).

    Of rows x (n, d) and K components it writes Σ_k 2^(peak_k - |root_k (1, x - shift)|²) to
    `out` (n,), with peaks (K,) <= 0 and roots (K, d, 1 + d) lower triangular after the first
    column. The first call compiles it, or loads what an earlier process compiled.

    Raises
    ------
    MissingExtraError
        If numba is not installed.
    """
    numba = _numba()
    first, rest = _power_of_two()
    # read-only, which takes writable arrays as well: compiled once for both
    given = [numba.types.Array(numba.float64, n, "C", readonly=True) for n in (2, 1, 1, 3)]

    # `contract` alone: sums keep their order, only a * b + c is rounded once
    @numba.njit(numba.types.void(*given, numba.float64[::1]), fastmath={"contract"}, cache=True)
    def totals(x, shift, peaks, roots, out):  # type: ignore[no-untyped-def] # noqa: ANN001, ANN202
        # one array: sums that happen to lie a page and a little from y would wait for its reads
        room = np.zeros((d + 1, _WIDTH))
        y, sums = room[:d], room[d]
        for start in range(0, len(x), _WIDTH):
            n = min(_WIDTH, len(x) - start)
            flat = x[start : start + n].reshape(-1)  # a stride known to the compiler
            for i in range(n):
                for j in range(d):
                    y[j, i] = flat[i * d + j] - shift[j]
            sums[:] = 0.0
            for k in range(len(peaks)):
                for i in range(_WIDTH):  # always all: a loop of known length is vectorised
                    t = peaks[k]
                    for a in range(d):
                        z = roots[k, a, 0]
                        for b in range(a + 1):
                            z += roots[k, a, 1 + b] * y[b, i]
                        t -= z * z
                    t = max(t, _LOWEST)
                    shifted = t + _ROUNDING
                    r = t - (shifted - _ROUNDING)
                    scale = np.int64(np.float64(shifted).view(np.int64) << _FRACTION)
                    p = first
                    for coefficient in rest:
                        p = coefficient + r * p
                    sums[i] += scale.view(np.float64) * p
            out[start : start + n] = sums[:n]

    kernel: Callable[..., None] = totals
    return kernel


def _numba() -> ModuleType:
    try:
        return import_module("numba")
    except ImportError as error:
        raise MissingExtraError(
            "fast: expected numba for the compiled kernel, found none; "
            "pip install 'crashrate[fast]', or leave `fast` out."
        ) from error


def _power_of_two() -> tuple[float, tuple[float, ...]]:
    """Coefficients of a polynomial for 2^r on [-1/2, 1/2], that of the highest power first."""
    half = [-0.5, 0.5]
    near_best = np.polynomial.Chebyshev.interpolate(np.exp2, _DEGREE, domain=half)
    powers = near_best.convert(kind=np.polynomial.Polynomial).coef.tolist()
    return powers[-1], tuple(reversed(powers[:-1]))
