"""Published numbers that ship with the package."""

from functools import cache
from importlib.resources import files

from crashrate.traffic.model import TrafficModel
from crashrate.variables import FloatArray

N_SPMD_EVENTS = 157_757


@cache
def spmd_mixture() -> TrafficModel:
    """The 9-component mixture that the 2017 study fitted to its SPMD lane changes.

    The study's published fit, not one of ours: variables ``v_lead`` [m/s], ``inv_range`` [1/m]
    and ``inv_ttc`` [1/s] of closing cut-ins with 5 <= v_lead <= 35 m/s and range <= 75 m.

    References
    ----------
    Z. Huang, H. Lam and D. Zhao, "An Accelerated Testing Approach for Automated Vehicles with
    Background Traffic Described by Joint Distributions" (2017); numbers from the repository
    zhao-lab/accelerated-evaluation (MIT licence).
    """
    text = files("crashrate.data").joinpath("spmd_mixture.json").read_text(encoding="utf-8")
    return TrafficModel.from_json(text)


def synthetic_spmd_events(n: int = N_SPMD_EVENTS, seed: int = 0) -> FloatArray:
    """Synthetic events (n, 3): draws from :func:`spmd_mixture`, not recordings.

    By default as many as the study's table holds of real ones.
    """
    return spmd_mixture().sample(n, seed)
