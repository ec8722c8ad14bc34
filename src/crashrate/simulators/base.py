"""What a simulator is: rows of situations in, one outcome per row out."""

import reprlib
from collections.abc import Mapping, Sequence
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from crashrate.errors import SimulationError
from crashrate.outcomes import Told, event_alone, outcome_table, what_came
from crashrate.variables import FloatArray


@runtime_checkable
class Simulator(Protocol):
    """Anything that can be called on rows of the traffic model's variables.

    An outcome is True or 1 for a crash, False or 0 for none, and NaN where the simulation failed:
    a failure is an outcome of its own, never "safe".
    """

    def __call__(self, x: FloatArray, /) -> Told:
        """The outcomes (n,) of the situations `x` (n, d).

        With K consequences declared, (n, 1 + K), or a mapping of names to (n,).
        """


def check_outcomes(
    outcomes: Told, n: int, what: str = "the simulator", consequences: Sequence[str] = ()
) -> FloatArray:
    """`outcomes` as an array (n,) of 1.0 (crash), 0.0 (none) and NaN (the simulation failed).

    With K consequences a table (n, 1 + K), the outcomes in its first column.

    Parameters
    ----------
    outcomes : array (n,) of bool, or of the numbers 1, 0 and NaN
        With consequences (n, 1 + K), or a mapping of their names, and one for the event, to (n,).
    n : int
        Number of rows that were simulated.
    what : str
        Names the simulator in the error.
    consequences : sequence of str
        Names of the numbers in [0, 1] that a run tells beside the event.

    Raises
    ------
    SimulationError
        If there is not one outcome per row, or one is something else, such as a safety margin.
    """
    if consequences:
        return outcome_table(outcomes, n, consequences, what, SimulationError)
    outcomes = event_alone(outcomes)
    if isinstance(outcomes, Mapping):
        raise SimulationError(
            f"{what}: expected one outcome per row, shape ({n},), got a mapping of "
            f"{', '.join(map(str, outcomes))}; declare what it tells beside the event under "
            "[outcome] consequences."
        )
    array = _as_array(outcomes, what)
    if array.shape != (n,):
        raise SimulationError(
            f"{what}: expected one outcome per row, shape ({n},), got {what_came(array)}."
        )
    if array.dtype.kind not in "biuf":
        raise SimulationError(
            f"{what}: expected booleans, or the numbers 1, 0 and NaN (failed), got dtype "
            f"{array.dtype}, such as {array[0]!r}."
        )
    values = array.astype(np.float64)
    odd = np.flatnonzero(~(np.isnan(values) | (values == 0.0) | (values == 1.0)))
    if len(odd):
        raise SimulationError(
            f"{what}: expected booleans, or the numbers 1, 0 and NaN (failed), got "
            f"{array[odd[0]]} at row {odd[0]} ({len(odd)} such outcomes of {n}, dtype "
            f"{array.dtype}); where it returns a margin, return the comparison, as in margin < 0, "
            "where it returns a probability draw the outcome by it."
        )
    return values


def _as_array(outcomes: npt.ArrayLike, what: str) -> npt.NDArray[np.generic]:
    try:
        return np.asarray(outcomes)
    except ValueError as error:  # lists of different lengths
        raise SimulationError(
            f"{what}: expected one outcome per row, got {reprlib.repr(outcomes)}, of unequal "
            "lengths."
        ) from error
