"""Events and laws of which everything is known: a crash where a + b (or a alone) is large."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from crashrate.events import EventTable
from crashrate.recordings.comparison import Comparison
from crashrate.recordings.severity import Severity
from crashrate.sampling.gaussians import Gaussians
from crashrate.traffic.model import TrafficModel

NAMES = ("a", "b")
LEVEL = 4.5  # of a alone: P(a > 4.5) = 3.4e-6 for a standard normal


@dataclass(frozen=True)
class KnownSet:
    """A learned crash set that is exactly a > level."""

    level: float = LEVEL
    proposal: Gaussians = field(
        default_factory=lambda: Gaussians(np.ones(1), np.array([[4.5, 0.0]]), np.eye(2)[None])
    )

    def __call__(self, z):
        return (z[:, 0] > self.level).astype(float)


def normal(mean=0.0, deviation=1.0):
    """Standard normal but for the law of a; b has a side at -1."""
    return TrafficModel(
        [1.0], [[mean, 0.0]], [np.diag([deviation**2, 1.0])], [-np.inf, -1.0], [np.inf] * 2, NAMES
    )


def table(x):
    return EventTable(NAMES, x, "drawn", np.arange(len(x)))


def comparison(model, events, seed=0):
    return Comparison(table(events), model, KnownSet(), Severity.multiplying("a", NAMES), seed)


@pytest.fixture(scope="session")
def known():
    """The pieces above, by name."""
    return {
        "normal": normal, "table": table, "comparison": comparison, "crash_set": KnownSet,
        "level": LEVEL, "names": NAMES,
    }  # fmt: skip
