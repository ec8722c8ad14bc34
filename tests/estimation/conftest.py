"""Problems with exact answers, and the statistical checks shared by these tests."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import binom, ncx2, norm

from crashrate.estimation.campaign import Campaign
from crashrate.estimation.run import estimate
from crashrate.estimation.view import View
from crashrate.sampling.gaussians import Gaussians
from crashrate.sampling.pool import draw_pool
from crashrate.traffic.model import TrafficModel


def standard_normal(d):
    names = tuple("abcdefghij"[:d])
    return TrafficModel(
        [1.0], np.zeros((1, d)), np.eye(d)[None], [-np.inf] * d, [np.inf] * d, names
    )


def increasing(d):
    return dict.fromkeys("abcdefghij"[:d], "increasing")


@dataclass(frozen=True)
class Case:
    """A crash set under a traffic model, with its exact probability."""

    traffic: TrafficModel
    crash: Callable[[np.ndarray], np.ndarray]
    probability: float
    risk: Mapping[str, object] | None

    def estimate(self, seed=0, **options):
        return estimate(self.crash, self.traffic, **{"risk": self.risk, "seed": seed} | options)

    def campaign(self, **options):
        return Campaign(self.traffic, **{"risk": self.risk} | options)


def half_plane(p, d=2):
    level = math.sqrt(d) * norm.isf(p)
    return Case(standard_normal(d), lambda x: x.sum(axis=1) >= level, p, increasing(d))


def orthant(p, d=2):
    level = norm.isf(p ** (1 / d))
    return Case(standard_normal(d), lambda x: (x >= level).all(axis=1), p, increasing(d))


def disc(p=1e-6, risk=None):
    center = np.array([4.6, 1.5])
    radius = brentq(lambda r: ncx2.cdf(r * r, 2, center @ center) - p, 0.1, 2)
    inside = lambda x: ((x - center) ** 2).sum(axis=1) < radius**2  # noqa: E731
    return Case(standard_normal(2), inside, p, risk)


def never(risk=None):
    return Case(standard_normal(2), lambda x: np.zeros(len(x), bool), 0.0, risk)


def always():
    return Case(standard_normal(2), lambda x: np.ones(len(x), bool), 1.0, increasing(2))


@pytest.fixture(scope="session")
def cases():
    return SimpleNamespace(
        half_plane=half_plane,
        orthant=orthant,
        tail=lambda p: half_plane(p, d=1),
        disc=disc,
        never=never,
        always=always,
        increasing=increasing,
        standard_normal=standard_normal,
    )


@pytest.fixture(scope="session")
def check_coverage():
    """Fails where so few intervals that hold the truth would happen once in a thousand runs."""

    def check(intervals, truth, confidence=0.95):
        low, high = np.asarray(intervals).T
        covered = int(np.count_nonzero((low <= truth) & (truth <= high)))
        chance = binom.cdf(covered, len(low), confidence)
        assert chance > 1e-3, f"{covered} of {len(low)} intervals hold {truth}: chance {chance:.1g}"

    return check


@pytest.fixture(scope="session")
def check_mean():
    """Fails where the mean of independent draws is four standard errors from the truth."""

    def check(draws, truth):
        draws = np.asarray(draws)
        error = draws.std(ddof=1) / math.sqrt(len(draws))
        z = (draws.mean() - truth) / error
        assert abs(z) < 4, f"mean {draws.mean():.6g}, expected {truth:.6g}: z = {z:.1f}"

    return check


@pytest.fixture(scope="session")
def drive():
    """Runs a method's generator against a simulator; returns its value and its queries."""

    def run(generator, simulate):
        queries, send = [], None
        while True:
            try:
                query = generator.send(send)
            except StopIteration as end:
                return end.value, queries
            queries.append(query)
            send = np.asarray(simulate(query.x), float)

    return run


@pytest.fixture
def small(monkeypatch):
    """Small pools, one kernel: campaigns that are quick, and otherwise the default ones."""
    from crashrate.estimation import aiming, beginning, exploration, kernels, sequential
    from crashrate.sampling import gaussians

    monkeypatch.setattr(gaussians, "EM_STEPS", 3)

    for module in (sequential, beginning):
        monkeypatch.setattr(module, "N_POOL", 600)
    for name, value in (("N_FIT", 100), ("N_COMPONENTS", 3)):
        monkeypatch.setattr(aiming, name, value)
    monkeypatch.setattr(kernels, "KERNELS", (kernels.Kernel(0.5, 2.0, 1e3),))
    monkeypatch.setattr(kernels, "ADDITIVE", ())
    for name, value in (("N_WIDE", 2000), ("N_ORDINARY", 1200)):
        monkeypatch.setattr(exploration, name, value)


@pytest.fixture(scope="session")
def toy_view():
    """A pool of a half-plane's problem seen with a wrong h; returns the view and the outcomes."""

    def make(rng, n=400):
        traffic = standard_normal(2)
        proposal = Gaussians(np.ones(1), np.full((1, 2), 0.8), 2 * np.eye(2)[None])
        pool = draw_pool(proposal, traffic, lambda x: x, n, rng)
        surrogate_h = rng.uniform(0.01, 0.99, n)
        lot = rng.random(n)
        inner, safe = lot < 0.1, lot > 0.9  # implied, and not seldom wrongly
        h = np.where(inner, 1.0, np.where(safe, 0.0, surrogate_h))
        outcomes = (pool.x.sum(axis=1) > 2).astype(float)
        none = np.zeros(len(h), dtype=bool)
        return View(pool, h, surrogate_h, inner, safe, inner, safe, none, ordered=True), outcomes

    return make
