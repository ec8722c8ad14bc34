"""Time and error of mixture log densities, against OpenTURNS and scikit-learn, in one run.

pip install -e ".[bench,fast]"    # OpenTURNS to compare with, numba for the compiled kernel
python benchmarks/density.py > benchmarks/results/density.md

`--quick` for a smoke test.
"""

import argparse
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from importlib.util import find_spec
from tempfile import TemporaryDirectory

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one core, before numpy is loaded
os.environ.setdefault("OMP_NUM_THREADS", "1")
# this folder: numba looks for a package `coverage`, and would find the benchmark of that name
sys.path.pop(0)

import numpy as np
from scipy.stats import multivariate_normal
from sklearn.mixture import GaussianMixture

from crashrate.traffic.log_mixture import LogMixture
from crashrate.traffic.model import TrafficModel

try:
    import openturns
except ImportError:
    openturns = None

CASES = [(2, 9), (3, 1), (3, 9), (3, 10), (3, 11), (3, 12), (3, 40), (6, 9)]  # d, K
SIZES = (20_000, 1_000_000)
_SHARED = 20_000  # rows that the slow ones are timed on: their time per row does not depend on it
_NUMPY_BAR, _FAST_BAR = 2.0, 1.0  # ns a point and component, K = 9 to 12, d = 3
_SIDE = 1e3  # of a box that holds all
FIRST = "--first"
FAST = find_spec("numba") is not None

Call = Callable[[np.ndarray], object]


class Law:
    """A random mixture, as each of the peers holds it."""

    def __init__(self, d: int, k: int) -> None:
        rng = np.random.default_rng([d, k])
        self.weights, self.means = rng.dirichlet(np.full(k, 5.0)), rng.normal(size=(k, d))
        spread = 0.4 * rng.standard_normal((k, d, d))
        self.covariances = spread @ spread.transpose(0, 2, 1) + 0.2 * np.eye(d)

    def sample(self, n: int) -> np.ndarray:
        """Draws (n, d)."""
        rng = np.random.default_rng(0)
        k = rng.choice(len(self.weights), size=n, p=self.weights)
        z = rng.standard_normal((n, self.means.shape[1]))
        return self.means[k] + np.einsum("nij,nj->ni", np.linalg.cholesky(self.covariances)[k], z)

    def ours(self) -> dict[str, Call]:
        """The kernels, and a traffic model on a box that holds all."""
        d = self.means.shape[1]
        mixture = LogMixture.of(
            self.weights, np.zeros(len(self.weights)), self.means, self.covariances,
            shift=self.weights @ self.means, scale=np.ones(d),
        )  # fmt: skip
        side, names = np.full(d, _SIDE), [f"x{j}" for j in range(d)]
        model = TrafficModel(self.weights, self.means, self.covariances, -side, side, names)
        calls: dict[str, Call] = {"NumPy": mixture.log_density, "model": model.log_density}
        if FAST:
            calls["fast"] = lambda x: mixture.log_density(x, fast=True)
            calls["model, fast"] = lambda x: model.log_density(x, fast=True)
        return calls

    def theirs(self) -> dict[str, Call]:
        """The same law elsewhere."""
        peer = GaussianMixture(len(self.weights))
        peer.weights_, peer.means_, peer.covariances_ = self.weights, self.means, self.covariances
        peer.precisions_cholesky_ = np.linalg.inv(np.linalg.cholesky(self.covariances)).transpose(
            0, 2, 1
        )
        calls: dict[str, Call] = {"scikit-learn": peer.score_samples}
        if openturns is not None:
            calls["OpenTURNS"] = self._openturns()
        return calls

    def _openturns(self) -> Call:
        laws = zip(self.means.tolist(), self.covariances.tolist(), strict=True)
        parts = [openturns.Normal(m, openturns.CovarianceMatrix(c)) for m, c in laws]
        mixture = openturns.Mixture(parts, self.weights.tolist())

        def log_density(x: np.ndarray) -> object:
            return mixture.computeLogPDF(x)

        return log_density

    def direct(self, x: np.ndarray) -> np.ndarray:
        """The reference: log sum exp over scipy's normals."""
        laws = zip(self.weights, self.means, self.covariances, strict=True)
        terms = [np.log(w) + multivariate_normal(m, c).logpdf(x) for w, m, c in laws]
        return np.logaddexp.reduce(terms, axis=0)


def cpu_ns(call: Call, x: np.ndarray) -> float:
    """Nanoseconds of one core, whatever else the machine does."""
    start = time.process_time_ns()
    call(x)
    return float(time.process_time_ns() - start)


def times(calls: dict[str, Call], x: np.ndarray, repeats: int) -> dict[str, list[float]]:
    """Of each call, taken in turns; the first round, uncounted, warms the caches."""
    out: dict[str, list[float]] = {name: [] for name in calls}
    for turn in range(repeats + 1):
        for name, call in calls.items():
            ns = cpu_ns(call, x)
            if turn:
                out[name].append(ns)
    return out


def error(law: Law) -> float:
    """Largest relative difference of our kernels from the reference."""
    x = law.sample(5000)
    exact = law.direct(x)
    found = [np.asarray(call(x)) for call in law.ours().values()]
    return max(float(np.max(np.abs(got - exact) / (1.0 + np.abs(exact)))) for got in found)


def row(d: int, k: int, n: int, repeats: int) -> dict[str, tuple[float, float]]:
    """Best and median ns a point and component of every kernel."""
    law, x = Law(d, k), Law(d, k).sample(n)
    ours = times(law.ours(), x, repeats)
    shared = x[: min(n, _SHARED)]
    theirs = times(law.theirs(), shared, max(2, repeats // 3))
    per = {name: (ns, n * k) for name, ns in ours.items()}
    per |= {name: (ns, len(shared) * k) for name, ns in theirs.items()}
    return {name: (min(ns) / m, float(np.median(ns)) / m) for name, (ns, m) in per.items()}


def cell(found: dict[str, tuple[float, float]], name: str) -> str:
    if name not in found:
        return "not installed"
    best, median = found[name]
    return f"{best:.2f} ({median:.2f})"


def ratio(found: dict[str, tuple[float, float]], ours: str) -> str:
    if "OpenTURNS" not in found or ours not in found:
        return ""
    return f"{found['OpenTURNS'][0] / found[ours][0]:.0f}"


def time_table(repeats: int, sizes: tuple[int, ...]) -> list[tuple[str, float]]:
    """Print the table; the figures that have a bar."""
    names = ("NumPy", "fast", "model", "model, fast", "OpenTURNS", "scikit-learn")
    print(f"| d | K | N | {' | '.join(names)} | OpenTURNS / NumPy | OpenTURNS / fast | error |")
    print("|" + "---|" * (len(names) + 6))
    barred = []
    for d, k in CASES:
        worst = f"{error(Law(d, k)):.0e}"
        for n in sizes:
            found = row(d, k, n, max(10, repeats * _SHARED // n))
            cells = [cell(found, name) for name in names]
            cells += [ratio(found, "NumPy"), ratio(found, "fast"), worst]
            print(f"| {d} | {k} | {n:,} | {' | '.join(cells)} |", flush=True)
            if d == 3 and 9 <= k <= 12:
                barred += [(name, found[name][0]) for name in ("NumPy", "fast") if name in found]
    return barred


def bars(barred: list[tuple[str, float]]) -> None:
    print("\nd = 3, K = 9 to 12, the best of the runs, ns a point and component:\n")
    for name, bar in (("NumPy", _NUMPY_BAR), ("fast", _FAST_BAR)):
        found = [ns for kernel, ns in barred if kernel == name]
        if found:
            held = sum(ns <= bar for ns in found)
            print(f"- {name}: {min(found):.2f} to {max(found):.2f}; bar {bar:g} held in "
                  f"{held} of {len(found)} rows")  # fmt: skip


def first_call() -> None:
    """Print CPU seconds of importing numba and of the first fast call, in a process of its own."""
    law = Law(3, 9)
    x = law.sample(10)
    start = time.process_time()
    law.ours()["fast"](x)
    print(time.process_time() - start)


def start_lines(directory: str) -> None:
    """What a process pays before its first fast call: with an empty cache, and with a full one."""
    environment = os.environ | {"NUMBA_CACHE_DIR": directory}
    seconds = [
        float(
            subprocess.run(
                [sys.executable, __file__, FIRST], env=environment, check=True, stdout=-1
            ).stdout
        )
        for _ in range(2)
    ]
    print(f"\nThe first fast call of a process costs {seconds[1]:.1f} CPU seconds, the very first")
    print(f"of a number of variables {seconds[0]:.1f}: it is compiled, and kept on disk.")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true")
    parser.add_argument(FIRST, action="store_true")
    options = parser.parse_args()
    if options.first:
        first_call()
        return
    named = ("crashrate", "numpy", "openturns", "scikit-learn", "numba")
    packages = ", ".join(
        f"{p} {version(p)}" for p in named if find_spec(p.replace("scikit-", "sk"))
    )
    print("# Mixture log densities: time and error\n")
    print(f"`python benchmarks/density.py{' --quick' if options.quick else ''}`; one core.")
    print(f"Python {platform.python_version()}, {packages}; {platform.machine()}.\n")
    print("Nanoseconds of CPU a point and component, all in turns: the best of the runs, and the")
    print("median in brackets. NumPy and fast are the kernel; *model* is a truncated model's log")
    print("density, with its checks of numbers and box. The peers get at most 20,000 rows. Error:")
    print("the largest, relative, of all of ours against scipy's normals.\n")
    barred = time_table(6 if options.quick else 60, SIZES[:1] if options.quick else SIZES)
    bars(barred)
    if FAST:
        with TemporaryDirectory() as directory:
            start_lines(directory)


if __name__ == "__main__":
    main()
