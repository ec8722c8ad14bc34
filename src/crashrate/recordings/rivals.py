"""Other laws of traffic beside the joint model, with the same checks."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from crashrate.recordings.comparison import Comparison
from crashrate.recordings.ladder import Ladder, ladder
from crashrate.traffic.alternatives import CopulaLaw
from crashrate.variables import FloatArray

N_DRAWS = 200_000


@dataclass(frozen=True, eq=False)
class Rival:
    """What another law makes of the same events and the same crash set.

    Parameters
    ----------
    name : str
    bic : float
        Bayesian information criterion, in units of the data, as of the joint model.
    probability, standard_error : float
        Of a crash, by what the campaign learned; the error is that of the draws alone.
    ladder : Ladder
        One level where no severity is declared.
    near_misses : tuple of tuple of float
        Events that it expects beyond the levels of each tail.
    """

    name: str
    bic: float
    probability: float
    standard_error: float
    ladder: Ladder
    near_misses: tuple[tuple[float, ...], ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """As JSON-ready values."""
        return vars(self) | {"ladder": self.ladder.to_dict()}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "Rival":
        """What `to_dict` wrote."""
        near = tuple(tuple(counts) for counts in values["near_misses"])
        steps = Ladder.from_dict(values["ladder"])
        return cls(**{**values, "ladder": steps, "near_misses": near})


Near = Callable[[FloatArray], tuple[tuple[float, ...], ...]]


def rival(c: Comparison, law: CopulaLaw, near: Near, stream: int) -> Rival:
    """A law, fitted to the events of a comparison, beside them.

    `near` counts near misses among its draws x (n, d); random streams from `stream` on.
    """
    log_likelihood = float(law.log_density(c.z).sum() + c.traffic.scales.log_jacobian(c.z).sum())
    draws = c.draws(law, stream)
    return Rival(
        law.name,
        -2 * log_likelihood + math.log(len(c.z)) * law.n_parameters,
        float(draws.probabilities[0]),
        float(draws.standard_errors[0]),
        ladder(c.levels, c.first, draws, c.rng(stream + 1)),
        near(c.traffic.scales.back(law.sample(N_DRAWS, c.rng(stream + 2)))),
    )
