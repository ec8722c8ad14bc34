"""From rows of the traffic model's variables to the inputs of a plant."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from crashrate.errors import InvalidInputError
from crashrate.expressions import Expression
from crashrate.simulators.acc_aeb import AccAeb, AccAebResult
from crashrate.variables import BoolArray, FloatArray, nearest

Column = Callable[[FloatArray], npt.ArrayLike]

INPUTS = ("v_lead", "range", "closing_speed")
EXAMPLES = {"v_lead": "v_lead", "range": "1 / inv_range", "closing_speed": "inv_ttc / inv_range"}


@dataclass(frozen=True)
class AccAebSimulator:
    """The ACC+AEB plant on rows of other variables.

    Parameters
    ----------
    plant : AccAeb
    columns : mapping or sequence of pairs
        For each of v_lead (m/s), range (m) and closing_speed (m/s): an `Expression`, or any
        function from rows (n, d) to values (n,). Stored as a tuple of pairs, in that order.

    Raises
    ------
    InvalidInputError
        If a column is missing or unknown.
    """

    plant: AccAeb
    columns: Mapping[str, Column] | Sequence[tuple[str, Column]]

    def __post_init__(self) -> None:
        given = dict(self.columns)
        for name in given:
            if name not in INPUTS:
                raise InvalidInputError(
                    f"columns of the ACC+AEB plant: unknown {name!r}{nearest(name, INPUTS)}."
                )
        missing = [name for name in INPUTS if name not in given]
        if missing:
            raise InvalidInputError(
                f"columns of the ACC+AEB plant: expected {', '.join(INPUTS)}; "
                f"{', '.join(missing)} is missing, for example Expression("
                f"{EXAMPLES[missing[0]]!r}, names)."
            )
        object.__setattr__(self, "columns", tuple((name, given[name]) for name in INPUTS))

    @classmethod
    def for_variables(
        cls,
        plant: AccAeb,
        names: Sequence[str],
        derived: Mapping[str, Expression] | None = None,
    ) -> "AccAebSimulator":
        """The plant on rows of `names`, where each input is a variable or a derived quantity.

        Raises
        ------
        InvalidInputError
            If v_lead, range or closing_speed is neither.
        """
        derived = derived or {}
        columns = tuple((name, _column(name, names, derived)) for name in INPUTS)
        return cls(plant, columns)

    def __call__(self, x: npt.ArrayLike) -> BoolArray:
        """Which of the situations `x` (n, d) crash: (n,)."""
        return self.run(x).crash

    def run(self, x: npt.ArrayLike) -> AccAebResult:
        """Everything that the plant says of the situations `x` (n, d).

        Raises
        ------
        InvalidInputError
            If the plant cannot start from a row, such as one with an infinite range.
        """
        inputs = self.inputs(x)
        return self.plant.run(**inputs)

    def altered(self, x: npt.ArrayLike) -> BoolArray:
        """Which of the situations `x` (n, d) the plant's caps change: (n,). Simulates nothing."""
        inputs = self.inputs(x)
        return self.plant.altered(v_lead=inputs["v_lead"], closing_speed=inputs["closing_speed"])

    def inputs(self, x: npt.ArrayLike) -> dict[str, FloatArray]:
        """The plant's inputs for the situations `x` (n, d), each (n,), by name."""
        rows = np.asarray(x, dtype=np.float64)
        return {
            name: np.asarray(column(rows), dtype=np.float64)
            for name, column in dict(self.columns).items()
        }


def _column(name: str, names: Sequence[str], derived: Mapping[str, Expression]) -> Expression:
    if name in derived:
        return derived[name]
    if name in names:
        return Expression(name, tuple(names))
    raise InvalidInputError(
        f"the ACC+AEB plant needs {name!r}, which is neither a variable nor a derived quantity "
        f"(known: {', '.join([*names, *derived])}); define it, for example as "
        f"{name} = {EXAMPLES[name]!r}."
    )
