"""crashrate: how often would this automated vehicle crash in ordinary traffic?

Names are imported on first use, so that ``import crashrate`` stays fast.
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from crashrate import datasets, errors, simulators
    from crashrate.crash_set.monotone_set import MonotoneSet
    from crashrate.estimation.campaign import Campaign
    from crashrate.estimation.estimate import Estimate
    from crashrate.estimation.run import estimate
    from crashrate.expressions import Expression
    from crashrate.traffic.mixture import TruncatedGaussianMixture
    from crashrate.traffic.model import TrafficModel
    from crashrate.variables import Variable

__version__ = version("crashrate")

_HOMES = {
    "Campaign": "crashrate.estimation.campaign",
    "Estimate": "crashrate.estimation.estimate",
    "Expression": "crashrate.expressions",
    "MonotoneSet": "crashrate.crash_set.monotone_set",
    "TrafficModel": "crashrate.traffic.model",
    "TruncatedGaussianMixture": "crashrate.traffic.mixture",
    "Variable": "crashrate.variables",
    "estimate": "crashrate.estimation.run",
}
_MODULES = ("datasets", "errors", "simulators")

__all__ = [
    "Campaign",
    "Estimate",
    "Expression",
    "MonotoneSet",
    "TrafficModel",
    "TruncatedGaussianMixture",
    "Variable",
    "__version__",
    "datasets",
    "errors",
    "estimate",
    "simulators",
]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    if name in _MODULES:
        return import_module(f"crashrate.{name}")
    raise AttributeError(f"module 'crashrate' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
