"""What a simulator is: rows of situations in, one outcome per row out."""

from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from crashrate.errors import SimulationError
from crashrate.variables import FloatArray


@runtime_checkable
class Simulator(Protocol):
    """Anything that can be called on rows of the traffic model's variables.

    An outcome is True or 1 for a crash, False or 0 for none, and NaN where the simulation failed:
    a failure is an outcome of its own, never "safe".
    """

    def __call__(self, x: FloatArray, /) -> npt.ArrayLike:
        """The outcomes (n,) of the situations `x` (n, d)."""


def check_outcomes(outcomes: npt.ArrayLike, n: int, what: str = "the simulator") -> FloatArray:
    """`outcomes` as an array (n,) of 1.0 (crash), 0.0 (none) and NaN (the simulation failed).

    Parameters
    ----------
    outcomes : array (n,) of bool, or of the numbers 1, 0 and NaN
    n : int
        Number of rows that were simulated.
    what : str
        Names the simulator in the error.

    Raises
    ------
    SimulationError
        If there is not one outcome per row, or one is something else, such as a safety margin.
    """
    array = _as_array(outcomes, what)
    if array.shape != (n,):
        raise SimulationError(
            f"{what}: expected one outcome per row, shape ({n},), got shape {array.shape} of "
            f"dtype {array.dtype}."
        )
    if array.dtype.kind not in "biuf":
        raise SimulationError(
            f"{what}: expected booleans, or the numbers 1, 0 and NaN (failed), got dtype "
            f"{array.dtype}."
        )
    values = array.astype(np.float64)
    odd = np.flatnonzero(~(np.isnan(values) | (values == 0.0) | (values == 1.0)))
    if len(odd):
        raise SimulationError(
            f"{what}: expected booleans, or the numbers 1, 0 and NaN (failed), got "
            f"{array[odd[0]]} at row {odd[0]} ({len(odd)} such outcomes of {n}, dtype "
            f"{array.dtype}); where it returns a margin, return the comparison, as in margin < 0."
        )
    return values


def _as_array(outcomes: npt.ArrayLike, what: str) -> npt.NDArray[np.generic]:
    try:
        return np.asarray(outcomes)
    except ValueError as error:  # lists of different lengths
        raise SimulationError(f"{what}: expected one outcome per row, got {error}.") from error
