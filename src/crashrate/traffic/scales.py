"""The scale on which each variable is modelled: its own units, or their logarithm."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from crashrate.errors import InvalidInputError
from crashrate.variables import BoolArray, FloatArray, Scale


@dataclass(frozen=True, slots=True)
class Scales:
    """x (units of the data) <-> z (where the components are normal), column by column.

    Parameters
    ----------
    each : tuple of Scale, length d
    """

    each: tuple[Scale, ...]

    @classmethod
    def parse(cls, scales: Sequence[str] | None, d: int) -> Self:
        """The scales named by `scales`, linear where that is None.

        Raises
        ------
        InvalidInputError
            If there is not one known name per variable.
        """
        if scales is None:
            return cls((Scale.LINEAR,) * d)
        if isinstance(scales, str) or len(scales) != d:
            raise InvalidInputError(
                f"scales: expected one for each of {d} variables, such as "
                f"{['linear'] * d}, got {scales!r}."
            )
        return cls(tuple(Scale.parse(s, f"scales[{i}]") for i, s in enumerate(scales)))

    @property
    def log(self) -> BoolArray:
        """Which variables (d,) are modelled by their logarithm."""
        return np.array([scale is Scale.LOG for scale in self.each])

    @property
    def linear(self) -> bool:
        """Whether z is x."""
        return not self.log.any()

    def forward(self, x: npt.ArrayLike) -> FloatArray:
        """x -> z, (…, d); -inf for a logarithm of 0."""
        z = np.array(x, dtype=np.float64)
        with np.errstate(divide="ignore"):
            z[..., self.log] = np.log(z[..., self.log])
        return z

    def back(self, z: npt.ArrayLike) -> FloatArray:
        """z -> x, (…, d)."""
        x = np.array(z, dtype=np.float64)
        x[..., self.log] = np.exp(x[..., self.log])
        return x

    def log_jacobian(self, z: FloatArray) -> FloatArray:
        """log |dz / dx| (n,) at rows z (n, d): added to a log density of z, gives that of x."""
        jacobian: FloatArray = -z[:, self.log].sum(axis=1)  # dz / dx is 1 / x
        return jacobian

    def require_positive(self, names: Sequence[str], x: FloatArray, what: str = "x") -> None:
        """Refuse rows x (n, d) whose logarithm there is not.

        Raises
        ------
        InvalidInputError
            Naming the first one.
        """
        bad = np.argwhere(self.log & (x <= 0.0))
        if len(bad):
            row, k = (int(i) for i in bad[0])
            raise InvalidInputError(
                f"{what}: expected positive numbers of {names[k]}, which is modelled on a log "
                f"scale, got {x[row, k]} at row {row} ({len(bad)} such values); use the scale "
                "'linear', or drop these rows."
            )
