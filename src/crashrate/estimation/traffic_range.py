"""What other traffic models that the events allow make of the same simulator runs."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from crashrate.variables import FloatArray

QUANTILES = (0.05, 0.5, 0.95)
UNDETERMINED = 0.7  # standard deviation of log P beyond which the events do not determine it
MIN_N_EFF = 5.0  # of a member whose own estimate counts as one


@dataclass(frozen=True, eq=False)
class TrafficRange:
    """The crash probability, or a consequence's expectation, under each of M traffic models.

    From one set of runs.

    Parameters
    ----------
    probabilities : tuple of float, length M
        Of the members; unbiased each, so that one may come out below 0.
    standard_errors : tuple of float, length M
        Monte Carlo errors.
    """

    probabilities: tuple[float, ...]
    standard_errors: tuple[float, ...]

    @cached_property
    def n_eff(self) -> FloatArray:
        """Effective sample sizes (M,): (probability / standard error)²."""
        p, error = np.array(self.probabilities), np.array(self.standard_errors)
        return np.asarray((np.maximum(p, 0.0) / error) ** 2)

    @property
    def upper(self) -> FloatArray:
        """Probabilities (M,), at least 0, two standard errors up."""
        return np.asarray(np.maximum(self.probabilities, 0.0) + 2 * np.array(self.standard_errors))

    @property
    def determined(self) -> FloatArray:
        """Probabilities of the members that the runs determine."""
        return np.array(self.probabilities)[self.n_eff >= MIN_N_EFF]

    @property
    def n_undetermined(self) -> int:
        """Members whose crashes lie where the runs have seen too little."""
        return len(self.probabilities) - len(self.determined)

    @property
    def quantiles(self) -> tuple[float, float, float]:
        """5, 50 and 95 % of the members' probabilities; NaN where two are not determined.

        A member that the runs do not determine enters as it is, at least 0.
        """
        if len(self.determined) < 2:
            return math.nan, math.nan, math.nan
        low, middle, high = np.quantile(np.maximum(self.probabilities, 0.0), QUANTILES)
        return float(low), float(middle), float(high)

    @property
    def log_deviation(self) -> float:
        """Standard deviation of log P over the members; NaN where two are not determined.

        A member that the runs do not determine enters with its upper value, two standard errors
        up, where that is still below the others' median; else it says nothing, and is left out.
        """
        return float(self._logs.std(ddof=1)) if len(self.determined) >= 2 else math.nan

    @property
    def _logs(self) -> FloatArray:
        """log P of the members that say something; see `log_deviation`."""
        found = self.determined
        low = self.upper[(self.n_eff < MIN_N_EFF) & (self.upper < np.median(found))]
        return np.asarray(np.log(np.concatenate([found, low])))

    @property
    def undetermined(self) -> bool:
        """Whether the events leave the probability open by more than a factor of two."""
        return not self.log_deviation <= UNDETERMINED

    def sentence(self, consequence: str = "") -> str:
        """The range in one sentence; of a consequence's expectation where its name is given."""
        what = "expectation" if consequence else "probability"
        head = f"traffic models, E({consequence})" if consequence else "traffic models"
        m = len(self.probabilities)
        low, middle, high = self.quantiles
        if math.isnan(middle):
            return f"{head}: {m} fits to the recordings, too few of them determined by the runs"
        least, half = (f"{q:.1e}" if q > 0 else "not determined" for q in (low, middle))
        text = (
            f"{m} fits to the recordings give {least} … {half} … {high:.1e} (5, 50, 95 %), "
            f"whose mean is the {what} above"
        )
        if n := self.n_undetermined:
            text += f"; {n} of them {'is' if n == 1 else 'are'} not determined by the runs"
        return f"{head}: {self._verdict(what)}{text}"

    def _verdict(self, what: str) -> str:
        """What the range means, before its numbers: a reader in a hurry stops there."""
        if not self.undetermined:
            return ""
        low, middle, high = self.quantiles
        told = [high / middle, middle / low] if low > 0 else [high / middle] if middle > 0 else []
        low, middle, high = np.exp(np.quantile(self._logs, QUANTILES))
        factor = max(*told, high / middle, middle / low)
        factor = min(factor, math.exp(3 * self.log_deviation))  # one member may be anywhere
        return (
            f"the recordings do not determine this {what} better than a factor "
            f"{factor:.0f} either way: "
        )

    def to_dict(self, consequence: str = "") -> dict[str, object]:
        """As JSON-ready values; `consequence` as of `sentence`."""
        return {
            "probabilities": list(self.probabilities),
            "standard_errors": list(self.standard_errors),
            "n_eff": self.n_eff.tolist(),
            "determined": (self.n_eff >= MIN_N_EFF).tolist(),
            "quantiles": list(self.quantiles),
            "log_deviation": self.log_deviation,
            "n_undetermined": self.n_undetermined,
            "sentence": self.sentence(consequence),
        }
