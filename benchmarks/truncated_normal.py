"""Error and time of box probabilities and draws of truncated normals, as a Markdown table.

pip install -e ".[bench]"    # mpmath for the reference, OpenTURNS for comparison
python benchmarks/truncated_normal.py > benchmarks/results/truncated_normal.md
"""

import os
import platform
import time
from collections.abc import Callable
from importlib.metadata import version
from importlib.util import find_spec

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one core, before numpy is loaded

import numpy as np
from mpmath import mp
from scipy.stats import multivariate_normal, norm

from crashrate import datasets
from crashrate.traffic.truncated_normal import box_moments, log_box_probability, sample_truncated

try:
    import openturns
except ImportError:
    openturns = None

INF = np.inf
_MAX_OPENTURNS = 3  # one box of five variables had not ended after three minutes
# name, correlation of every pair, sides
CASES = [
    ("d=2, body", 0.5, [0.0] * 2, [INF] * 2),
    ("d=2, tail", 0.5, [25.0] * 2, [INF] * 2),
    ("d=2, correlation 0.9999, corner", 0.9999, [0.0, -INF], [INF, -0.03]),
    ("d=3, body", 0.5, [0.0] * 3, [INF] * 3),
    ("d=3, mixed sides", 0.5, [-1.0, 0.2, -INF], [2.0, INF, 0.3]),
    ("d=3, a ten-thousandth wide", 0.5, [1.0, 2.0, 3.0], [1.0001, 2.0001, 3.0001]),
    ("d=3, the same, open sides", 0.5, [1.0, 2.0, -INF], [1.0001, INF, 3.0]),
    ("d=3, correlation 0.99", 0.99, [0.0] * 3, [INF] * 3),
    ("d=3, correlation 0.9999", 0.9999, [0.0] * 3, [INF] * 3),
    ("d=3, correlation 0.9999, corner", 0.9999, [0.0, -INF, -1.0], [INF, -0.03, 1.0]),
    ("d=3, correlation 0.9999, tail", 0.9999, [20.0] * 3, [INF] * 3),
    ("d=3, tail", 0.5, [12.0] * 3, [INF] * 3),
    ("d=3, far tail", 0.5, [30.0] * 3, [INF] * 3),
    ("d=5, body", 0.5, [0.0] * 5, [INF] * 5),
    ("d=5, tail", 0.5, [6.0] * 5, [INF] * 5),
    ("d=5, far tail", 0.5, [28.0] * 5, [INF] * 5),
    ("d=5, correlation 0.9999", 0.9999, [0.0] * 5, [INF] * 5),
    ("d=10, body", 0.5, [0.0] * 10, [INF] * 10),
    ("d=10, tail", 0.5, [6.0] * 10, [INF] * 10),
    ("d=10, mixed sides", 0.5, [-1.0, -INF] * 5, [INF, 1.0] * 5),
    ("d=10, correlation 0.9999", 0.9999, [0.0] * 10, [INF] * 10),
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
    """Log probability of a box under equal correlations: one integral over the common factor.

    In 40 digits, none of them from crashrate; double precision only says where to integrate.
    """
    with mp.workdps(40):
        side, root = mp.sqrt(1 - mp.mpf(rho)), mp.sqrt(mp.mpf(rho))
        sides = [(mp.mpf(a), mp.mpf(b)) for a, b in zip(lower, upper, strict=True)]

        def integrand(t: mp.mpf) -> mp.mpf:
            spans = [((a - root * t) / side, (b - root * t) / side) for a, b in sides]
            return mp.fprod(_interval(a, b) for a, b in spans) * mp.npdf(t)

        panels, top = _panels(rho, lower, upper)
        scale = mp.exp(-top)  # quad's tolerance is absolute
        area = mp.quad(lambda t: scale * integrand(t), panels, method="gauss-legendre")
        return float(mp.log(area) + top)


def _interval(a: mp.mpf, b: mp.mpf) -> mp.mpf:
    """P(a <= Z <= b), from the tail in which it does not cancel."""
    a, b = (-b, -a) if a + b < 0 else (a, b)
    return (mp.erfc(a / mp.sqrt(2)) - mp.erfc(b / mp.sqrt(2))) / 2


def _panels(rho: float, lower: list[float], upper: list[float]) -> tuple[list[float], float]:
    """Ends of short panels where the integrand matters to 1e-20, and its largest logarithm."""
    side, root = np.sqrt(1.0 - rho), np.sqrt(rho)
    t = np.linspace(-60.0, 60.0, 240_001)[:, None]
    low, high = np.array(lower) - root * t, np.array(upper) - root * t
    with np.errstate(divide="ignore"):
        log_p = np.where(
            low + high > 0.0,
            norm.logsf(low / side) + np.log(-np.expm1(_drop(low, high, side))),
            norm.logcdf(high / side) + np.log(-np.expm1(_drop(-high, -low, side))),
        )
    logs = log_p.sum(axis=1) - 0.5 * t[:, 0] ** 2
    top = float(np.nanmax(logs))
    reach = t[logs > top - 46.0, 0]
    return np.linspace(reach.min() - 0.01, reach.max() + 0.01, 121).tolist(), top


def _drop(near: np.ndarray, far: np.ndarray, side: float) -> np.ndarray:
    """log P(Z > far) / P(Z > near)."""
    return np.minimum(norm.logsf(far / side) - norm.logsf(near / side), -1e-300)


def scipy_error(
    exact: float, covariance: np.ndarray, lower: list[float], upper: list[float]
) -> tuple[str, str]:
    """Relative error and time of scipy's multivariate normal on the same box."""
    law = multivariate_normal(np.zeros(len(lower)), covariance, seed=0)

    def call() -> float:
        return float(law.cdf(np.array(upper), lower_limit=np.array(lower)))

    return _their_error(call, exact)


def openturns_error(
    exact: float, covariance: np.ndarray, lower: list[float], upper: list[float]
) -> tuple[str, str]:
    """The same of OpenTURNS."""
    if openturns is None:
        return "not installed", ""
    d = len(lower)
    if d > _MAX_OPENTURNS:
        return "not run: minutes", ""
    law = openturns.Normal([0.0] * d, openturns.CovarianceMatrix(covariance.tolist()))
    finite = (
        [v if np.isfinite(v) else -1e300 for v in lower],
        [v if np.isfinite(v) else 1e300 for v in upper],
    )
    flags = [bool(np.isfinite(v)) for v in lower], [bool(np.isfinite(v)) for v in upper]
    box = openturns.Interval(*finite, *flags)
    return _their_error(lambda: float(law.computeProbability(box)), exact)


def _their_error(call: Callable[[], float], exact: float) -> tuple[str, str]:
    start = time.perf_counter()
    value = call()
    seconds = time.perf_counter() - start
    if seconds < 0.1:  # slower ones are not timed again
        seconds = best_of(call, 3)
    if value <= 0.0:
        return "returns 0", f"{1e3 * seconds:.2f}"
    return f"{abs(np.expm1(np.log(value) - exact)):.0e}", f"{1e3 * seconds:.2f}"


def probability_table() -> None:
    print("| box | log P | relative error | bar | ms | scipy: error | ms | OpenTURNS: error | ms |")
    print("|---|---|---|---|---|---|---|---|---|")
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
        theirs = [
            cell
            for judge in (scipy_error, openturns_error)
            for cell in judge(exact, covariance, lower, upper)
        ]
        bar = 1e-10 if d <= 3 else 1e-4
        held = f"{bar:.0e} {'held' if error <= bar else 'MISSED'}"
        cells = [name, f"{exact:.3f}", f"{error:.0e}", held, f"{1e3 * best_of(call):.2f}", *theirs]
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
        ("log density of 20,000 rows", lambda: model.log_density(rows)),
        ("157,757 draws of the published mixture", lambda: model.sample(157_757, 1)),
    ]
    print("\n| job (d = 3, K = 9) | ms |")
    print("|---|---|")
    times = {name: best_of(call) for name, call in jobs}
    for name, seconds in times.items():
        print(f"| {name} | {1e3 * seconds:.1f} |")
    each = 1e6 * times[jobs[1][0]] / (500 * model.n_components)
    print(f"\nIn a batch: {each:.0f} µs a box and component (bar 150).")


def sampling_table() -> None:
    covariance = np.full((3, 3), 0.5) + 0.5 * np.eye(3)
    n = 200_000
    print("\n| draws, d = 3 | log P | million draws / s (bar 1) |")
    print("|---|---|---|")
    for at in (-1.0, 0.0, 2.0, 5.7, 20.0):  # 5.7: a box of 1e-13; 20: of 1e-134
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


def found(package: str) -> bool:
    return find_spec(package) is not None


def main() -> None:
    print("# Truncated normals: error and time\n")
    print("`python benchmarks/truncated_normal.py`, one core, the best of several runs.")
    packages = ", ".join(
        f"{p} {version(p)}"
        for p in ("crashrate", "numpy", "scipy", "openturns", "mpmath")
        if found(p)
    )
    print(f"Python {platform.python_version()}, {packages}; {platform.machine()}.\n")
    print("Reference: the integral over the common factor of equally correlated variables, in 40")
    print("digits. Bars: of the relative error.\n")
    probability_table()
    batch_table()
    sampling_table()


if __name__ == "__main__":
    main()
