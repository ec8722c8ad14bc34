"""Error and time of box probabilities and draws of truncated normals, as a Markdown table.

python benchmarks/truncated_normal.py > benchmarks/results/truncated_normal.md
"""

import os
import platform
import time
from collections.abc import Callable
from importlib.metadata import version

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one core, before numpy is loaded

import numpy as np
from scipy.integrate import quad
from scipy.stats import multivariate_normal

from crashrate import datasets
from crashrate.traffic.one_dimension import log_interval_probability
from crashrate.traffic.truncated_normal import box_moments, log_box_probability, sample_truncated

INF = np.inf
CASES = [
    ("d=2, body", 0.5, [0.0] * 2, [INF] * 2),
    ("d=2, tail", 0.5, [25.0] * 2, [INF] * 2),
    ("d=3, body", 0.5, [0.0] * 3, [INF] * 3),
    ("d=3, mixed sides", 0.5, [-1.0, 0.2, -INF], [2.0, INF, 0.3]),
    ("d=3, narrow", 0.5, [1.0, 2.0, 3.0], [1.000001, 2.000001, 3.000001]),
    ("d=3, correlation 0.99", 0.99, [0.0] * 3, [INF] * 3),
    ("d=3, tail", 0.5, [12.0] * 3, [INF] * 3),
    ("d=3, far tail", 0.5, [25.0] * 3, [INF] * 3),
    ("d=5, body", 0.5, [0.0] * 5, [INF] * 5),
    ("d=5, tail", 0.5, [6.0] * 5, [INF] * 5),
    ("d=10, body", 0.5, [0.0] * 10, [INF] * 10),
]


def best_of(call: Callable[[], object], repeats: int = 5) -> float:
    """Shortest time of a call [s]; the first, uncounted one warms the caches."""
    call()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return min(times)


def reference(rho: float, lower: list[float], upper: list[float]) -> float:
    """Log probability of a box under equal correlations: one integral over the common factor."""
    low, high = np.array(lower), np.array(upper)
    side, root = np.sqrt(1.0 - rho), np.sqrt(rho)

    def log_integrand(t: float) -> float:
        inner = log_interval_probability((low - root * t) / side, (high - root * t) / side)
        return float(inner.sum() - 0.5 * t * t - 0.5 * np.log(2 * np.pi))

    grid = np.linspace(-60.0, 60.0, 24_001)
    logs = np.array([log_integrand(t) for t in grid])
    peak, top = float(grid[logs.argmax()]), float(logs.max())
    reach = grid[logs > top - 45.0]
    area = quad(
        lambda t: np.exp(log_integrand(t) - top),
        reach.min() - 0.01,
        reach.max() + 0.01,
        points=[peak],
        epsabs=0.0,
        epsrel=1e-12,
        limit=1000,
    )[0]
    return top + float(np.log(area))


def scipy_error(
    exact: float, covariance: np.ndarray, lower: list[float], upper: list[float]
) -> tuple[str, str]:
    """Relative error and time of scipy's multivariate normal on the same box."""
    law = multivariate_normal(np.zeros(len(lower)), covariance, seed=0)

    def call() -> float:
        return float(law.cdf(np.array(upper), lower_limit=np.array(lower)))

    seconds = best_of(call, 3)
    value = call()
    if value <= 0.0:
        return "returns 0", f"{1e3 * seconds:.2f}"
    return f"{abs(np.expm1(np.log(value) - exact)):.0e}", f"{1e3 * seconds:.2f}"


def probability_table() -> None:
    print("| box | log P | relative error | ms | scipy: relative error | ms |")
    print("|---|---|---|---|---|---|")
    for name, rho, lower, upper in CASES:
        d = len(lower)
        covariance = np.full((d, d), rho) + (1.0 - rho) * np.eye(d)
        exact = reference(rho, lower, upper)

        def call(
            d: int = d,
            covariance: np.ndarray = covariance,
            lower: list[float] = lower,
            upper: list[float] = upper,
        ) -> np.ndarray:
            return log_box_probability(np.zeros(d), covariance, lower, upper)

        error = abs(np.expm1(call()[0] - exact))
        theirs = scipy_error(exact, covariance, lower, upper)
        cells = [name, f"{exact:.3f}", f"{error:.0e}", f"{1e3 * best_of(call):.2f}", *theirs]
        print(f"| {' | '.join(cells)} |")


def batch_table() -> None:
    model = datasets.spmd_mixture()
    rng = np.random.default_rng(0)
    lo, rows = model.sample(500, rng), model.sample(20_000, rng)
    hi = np.full_like(lo, INF)
    box = (model.means, model.covariances, model.lower, model.upper)
    jobs: list[tuple[str, Callable[[], object]]] = [
        ("moments of the 9 published components", lambda: box_moments(*box)),
        ("500 boxes under the published mixture", lambda: model.box_probability(lo, hi)),
        (
            "log density of 20,000 rows",
            lambda: model.log_density(rows),
        ),
        ("157,757 draws of the published mixture", lambda: model.sample(157_757, 1)),
    ]
    print("\n| job (d = 3, K = 9) | ms |")
    print("|---|---|")
    for name, call in jobs:
        print(f"| {name} | {1e3 * best_of(call):.1f} |")


def sampling_table() -> None:
    covariance = np.full((3, 3), 0.5) + 0.5 * np.eye(3)
    n = 200_000
    print("\n| draws, d = 3 | log P | million draws / s |")
    print("|---|---|---|")
    for at in (-1.0, 0.0, 2.0, 6.0, 20.0):
        lower = np.full(3, at)
        log_p = log_box_probability(np.zeros(3), covariance, lower, np.full(3, INF))[0]
        rng = np.random.default_rng(0)
        seconds = best_of(
            lambda lower=lower, rng=rng: sample_truncated(
                np.zeros(3), covariance, lower, np.full(3, INF), n, rng
            ),
            3,
        )
        print(f"| x >= {at:g} | {log_p:.1f} | {n / seconds / 1e6:.1f} |")


def main() -> None:
    print("# Truncated normals: error and time\n")
    print("`python benchmarks/truncated_normal.py`, one core, the best of several runs.")
    packages = ", ".join(f"{p} {version(p)}" for p in ("crashrate", "numpy", "scipy"))
    print(f"Python {platform.python_version()}, {packages}; {platform.machine()}.\n")
    print("Reference: the integral over the common factor of equally correlated variables.\n")
    probability_table()
    batch_table()
    sampling_table()


if __name__ == "__main__":
    main()
