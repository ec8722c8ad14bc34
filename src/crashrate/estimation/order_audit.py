"""What an audit of the risk order found: how much of what the order implies can be wrong."""

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class OrderAudit:
    """What random runs say of the outcomes that the risk order implies.

    Parameters
    ----------
    n_crash, n_crash_wrong : int
        Draws of traffic among the situations implied to crash, and those that did not, failed
        simulations among them.
    crash_share : float
        Upper limit for the share of P(inner) that does not crash.
    n_safe, n_safe_wrong : int
        Draws of traffic among those implied to be safe, from the layer next to the outer set; and
        those that crashed or failed.
    safe_share : float
        Upper limit for the share of the layer that crashes.
    layer : float
        Probability of the layer.
    confidence : float
        At which both limits hold together.
    """

    n_crash: int
    n_crash_wrong: int
    crash_share: float
    n_safe: int
    n_safe_wrong: int
    safe_share: float
    layer: float
    confidence: float

    @property
    def crash_mass_missed(self) -> float:
        """Upper limit for the probability of crashes in the layer, where the order says safe."""
        return self.safe_share * self.layer

    def least(self, bounds: tuple[float, float]) -> float:
        """What `bounds` leave as a lower limit of the probability where the order is not exact."""
        return bounds[0] * (1 - self.crash_share)

    def sentence(self, bounds: tuple[float, float]) -> str:
        """What was audited, and what that leaves."""
        return (
            f"audit of the order: of {self.n_crash} runs implied to crash {self.n_crash_wrong} did "
            f"not, of {self.n_safe} implied to be safe next to P(outer) {self.n_safe_wrong} did; "
            f"at {100 * self.confidence:g} % P(inner) is wrong by at most "
            f"{100 * self.crash_share:.0f} % (p ≥ {self.least(bounds):.1e} whatever the order), "
            f"and P(outer) misses at most {self.crash_mass_missed:.1e} of the {self.layer:.1e} "
            "next to it; what lies farther was probed, not bounded"
        )

    def to_dict(self, bounds: tuple[float, float]) -> dict[str, Any]:
        """As JSON-ready values."""
        return asdict(self) | {
            "least_probability": self.least(bounds),
            "crash_mass_missed": self.crash_mass_missed,
            "sentence": self.sentence(bounds),
        }
