"""Active Kriging with subset simulation (AK-SS), the most frugal of the methods with a surrogate.

A Gaussian process is fitted to the margin and told new calls where its sign is least certain
(U = |mean| / deviation, Echard, Gayton & Lemaire 2011) among the samples of a subset simulation
run on the process (Huang, Chen & Zhu 2016), until U ≥ 2 everywhere. The process then answers
in the simulator's place.

No released package does this today: pystra's is in an unreleased 2.0, UQpy pins NumPy 1.26 and
scikit-learn 1.4. So the method is put together here from OpenTURNS' subset simulation and
scikit-learn's Gaussian process.
"""

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
import openturns as ot
from scipy.special import ndtri
from scipy.stats import multivariate_normal, qmc
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Kernel, Matern
from sklearn.mixture import GaussianMixture

from peers.limit_state import Answer, LimitState
from peers.peer import Peer
from problems import Rows

Z, TINY = 1.959963984540054, 1e-300
Settings = Mapping[str, Any]


def active_kriging(limit: LimitState, seed: int, settings: Settings) -> Answer:
    """AK-SS, and an interval that allows for the process's own doubt."""
    ot.RandomGenerator.SetSeed(seed)
    u = _start(limit.dimension, seed, settings)
    g = limit(u)
    process = _fit(u, g, seed, restarts=3)
    for added in range(1, settings["most_added"] + 1):
        candidates = _subset(process, limit.dimension, settings["candidates"])
        mean, deviation = process.predict(candidates, return_std=True)
        doubt = np.abs(mean) / np.maximum(deviation, TINY)
        if doubt.min() >= settings["enough"]:
            break
        chosen = candidates[[doubt.argmin()]]
        u, g = np.vstack([u, chosen]), np.append(g, limit(chosen))
        process = _fit(u, g, seed, process.kernel_, restarts=0 if added % 10 else 3)
    return _answer(process, limit.dimension, seed, settings)


def _start(d: int, seed: int, settings: Settings) -> Rows:
    """Latin hypercube of normals that are wide enough to reach the crash set."""
    uniform = qmc.LatinHypercube(d, rng=np.random.default_rng(seed)).random(3 * d + 9)
    return np.asarray(settings["spread"] * ndtri(uniform))


def _fit(
    u: Rows, g: Rows, seed: int, kernel: Kernel | None = None, *, restarts: int
) -> GaussianProcessRegressor:
    """A process with a length for every variable, by maximum likelihood, from `kernel` on."""
    d = u.shape[1]
    if kernel is None:
        kernel = ConstantKernel(1.0, (1e-3, 1e5)) * Matern([3.0] * d, [(0.3, 300.0)] * d, nu=2.5)
    process = GaussianProcessRegressor(
        kernel, alpha=1e-9, normalize_y=True, n_restarts_optimizer=restarts, random_state=seed
    )
    with warnings.catch_warnings():
        # a length at its bound is what a linear margin asks for
        warnings.simplefilter("ignore", ConvergenceWarning)
        return process.fit(u, g)


def _subset(process: GaussianProcessRegressor, d: int, n: int) -> Rows:
    """All samples of a subset simulation on the process's mean."""
    samples: list[Rows] = []

    def mean(u: ot.Sample) -> Rows:
        samples.append(np.array(u))
        return np.asarray(process.predict(samples[-1]))[:, None]

    vector = ot.CompositeRandomVector(
        ot.PythonFunction(d, 1, func_sample=mean), ot.RandomVector(ot.Normal(d))
    )
    algorithm = ot.SubsetSampling(ot.ThresholdEvent(vector, ot.LessOrEqual(), 0.0))
    algorithm.setBlockSize(n // 10)  # as many as a level keeps: chains of ten steps
    algorithm.setMaximumOuterSampling(10)
    algorithm.setMinimumProbability(1e-10)
    try:
        algorithm.run()
    except RuntimeError as error:
        # a process that knows no crash: the samples on the way down are candidates all the same
        if "Probability estimate too small" not in str(error):
            raise
    return np.vstack(samples)


def _answer(process: GaussianProcessRegressor, d: int, seed: int, settings: Settings) -> Answer:
    """From the most cautious to the most daring reading of the process, and its sampling error.

    Importance sampling on the process alone, from normals fitted to the crashes of a last subset
    simulation, whose own estimate would add its scatter.
    """
    samples = _subset(process, d, settings["last"])
    crashes = samples[process.predict(samples) <= 0]
    if len(crashes) < settings["components"] * (d + 1):
        return Answer(0.0, 0.0, 0.0, ("the process knows no crash",))
    u, weights = _aimed(crashes, seed, settings)
    mean, deviation = process.predict(u, return_std=True)
    p, low, high = (float(weights[mean + z * deviation <= 0].sum()) for z in (0.0, Z, -Z))
    error = Z * float(np.sqrt((weights[mean <= 0] ** 2).sum()))
    note = f"doubt of the process: {low:.3g} to {high:.3g}"
    return Answer(p, min(low, p - error), max(high, p + error), (note,))


def _aimed(crashes: Rows, seed: int, settings: Settings) -> tuple[Rows, Rows]:
    """Draws around `crashes`, a share of them wider, and their weights over their number."""
    rng = np.random.default_rng(seed)
    fitted = GaussianMixture(settings["components"], reg_covar=1e-3, random_state=seed)
    fitted.fit(crashes[rng.choice(len(crashes), min(len(crashes), 5000), replace=False)])
    components = [
        (weight * share, mean, factor * covariance)
        for share, factor in ((0.7, 1.0), (0.3, 3.0))
        for weight, mean, covariance in zip(
            fitted.weights_, fitted.means_, fitted.covariances_, strict=True
        )
    ]
    shares = np.array([share for share, _, _ in components])
    counts = rng.multinomial(settings["draws"], shares / shares.sum())
    u = np.vstack(
        [
            rng.multivariate_normal(mean, covariance, size=count)
            for count, (_, mean, covariance) in zip(counts, components, strict=True)
        ]
    )
    densities = [share * multivariate_normal(m, c).pdf(u) for share, m, c in components]
    nominal = multivariate_normal(np.zeros(u.shape[1])).pdf(u)
    return u, nominal / np.sum(densities, axis=0) / len(u)


SETTINGS = {
    "spread": 2.5,  # the start reaches 5 σ in every variable: it sees crash and safe
    "candidates": 2000,  # a level of each subset simulation among which the next call is chosen
    "enough": 2.0,  # U of the literature
    "most_added": 100,
    "last": 10_000,  # a level of the last one, on the process alone
    "components": 6,  # normals for the importance sampling on it
    "draws": 50_000,  # by which it is exact to a percent or two
}
PEERS = (Peer("active Kriging (AK-SS)", "openturns", active_kriging, SETTINGS),)
