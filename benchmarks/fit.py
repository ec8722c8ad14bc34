"""Time and memory of mixture fits: an EM pass, whole fits, the choice of K, growth with N.

python benchmarks/fit.py > benchmarks/results/fit.md

`--quick` for a smoke test. The recorded events are looked for at ../shared/data.
"""

import argparse
import os
import platform
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one core, before numpy is loaded

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.mixture import GaussianMixture

from crashrate import datasets
from crashrate.runs.fitting import read_scenario_events
from crashrate.runs.scenario import Scenario
from crashrate.traffic import fitting
from crashrate.traffic.components import select_components
from crashrate.traffic.mixture import TruncatedGaussianMixture

HERE = Path(__file__).resolve().parent
RECORDED = HERE.parent / "../shared/data/spmd_lane_changes.parquet"
EXAMPLES = {"(v, log 1/R, closing speed)": "cut_in", "(v, 1/R, 1/TTC)": "huang2017"}
PEAK = "--peak"


def cpu_seconds(call: Callable[[], object]) -> float:
    """Seconds of one core, whatever else the machine does."""
    start = time.process_time()
    call()
    return time.process_time() - start


def fit(rows: np.ndarray, box: dict[str, object], k: int = 9, **more: object) -> object:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        return TruncatedGaussianMixture(k, **box, **more).fit(rows)


def recorded(name: str) -> tuple[np.ndarray, dict[str, object]]:
    """The recorded events in the variables of an example, and its box."""
    scenario = Scenario.from_file(HERE.parent / "examples" / f"{name}.toml")
    scales = [v.scale.value for v in scenario.variables]
    box = {"lower": scenario.lower, "upper": scenario.upper, "scales": scales}
    return read_scenario_events(scenario, RECORDED, drop_invalid=True).values, box


def synthetic(n: int) -> tuple[np.ndarray, dict[str, object]]:
    """Draws of the published mixture."""
    law = datasets.spmd_mixture()
    return law.sample(n, 0), {"lower": law.lower, "upper": law.upper}


def pass_seconds(rows: np.ndarray, box: dict[str, object], repeats: int) -> tuple[float, float]:
    """Medians of one EM pass, E-step with its sums and M-step: ours and scikit-learn's."""
    fitted = fit(rows, box, max_iter=5)
    events, prior, mixture = state_of(rows, fitted)
    theirs = GaussianMixture(9, max_iter=1, init_params="random_from_data", random_state=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        theirs.fit(rows)
    ours_all, theirs_all = [], []
    for _ in range(repeats):
        ours_all.append(cpu_seconds(lambda: fitting.lee_scott_step(events, prior, mixture)))
        theirs_all.append(cpu_seconds(lambda: sklearn_step(theirs, rows)))
    return float(np.median(ours_all)), float(np.median(theirs_all))


def sklearn_step(mixture: GaussianMixture, rows: np.ndarray) -> None:
    _, log_responsibilities = mixture._e_step(rows)  # noqa: SLF001 - a pass has no public name
    mixture._m_step(rows, log_responsibilities)  # noqa: SLF001


def state_of(
    rows: np.ndarray, fitted: object
) -> tuple[fitting.Events, fitting.Prior, fitting.Mixture]:
    """Events, prior and mixture as a fit holds them."""
    from crashrate.traffic.natural import to_natural
    from crashrate.traffic.standard import Standard
    from crashrate.traffic.truncated_components import components_at

    model = fitted.model_
    z, low, high = (model.scales.forward(v) for v in (rows, model.lower, model.upper))
    standard = Standard.of(z, low, high)
    events = fitting.Events(standard.forward(z), standard.box)
    prior = fitting.Prior(1.0, np.zeros(events.d), standard.correlation)
    theta = to_natural(
        standard.forward(model.means), standard.forward_covariances(model.covariances)
    )
    components = components_at(theta, standard.box)
    return events, prior, fitting.mixture_at(events, prior, np.log(model.weights), components)


def pass_table(repeats: int) -> None:
    print("## One EM pass\n")
    print("CPU seconds, alternating, medians; scikit-learn's knows of no box.\n")
    print("| N | ours, ms | scikit-learn, ms | ratio (bar 0.10) | ours, ns per event |")
    print("|---|---|---|---|---|")
    data = [recorded("huang2017")] if RECORDED.exists() else []
    for rows, box in [*data, *(synthetic(n) for n in (100_000, 300_000, 1_000_000))]:
        ours, theirs = pass_seconds(rows, box, repeats)
        cells = f"{1e3 * ours:.1f} | {1e3 * theirs:.0f} | {ours / theirs:.3f}"
        print(f"| {len(rows):,} | {cells} | {1e9 * ours / len(rows):.0f} |", flush=True)


def whole_fits(rows: np.ndarray, box: dict[str, object], seeds: int) -> list[tuple[float, float]]:
    """CPU seconds and log likelihood of fits from different starts."""
    out = []
    for seed in range(seeds):
        start = time.process_time()
        fitted = fit(rows, box, random_state=seed)
        out.append((time.process_time() - start, fitted.log_likelihood_))
    return out


def fit_table(seeds: int) -> None:
    print("\n## A whole fit, K = 9\n")
    print(f"Recorded events, starts 0 to {seeds - 1}; *from all events* without the first fit to")
    print("a part of them. Gain: of log likelihood, mean over starts, against that.\n")
    print("| variables | way | CPU s, median (bar 2.5) | range | best log likelihood | gain |")
    print("|---|---|---|---|---|---|")
    for words, name in EXAMPLES.items():
        rows, box = recorded(name)
        first = fitting._N_PART  # noqa: SLF001 - what is compared
        fitting._N_PART = len(rows)  # noqa: SLF001
        plain = whole_fits(rows, box, seeds)
        fitting._N_PART = first  # noqa: SLF001
        default = whole_fits(rows, box, seeds)
        base = np.mean([pair[1] for pair in plain])
        for way, pairs in (("from all events", plain), ("default", default)):
            seconds, values = np.array(pairs).T
            cells = f"{np.median(seconds):.2f} | {seconds.min():.2f} to {seconds.max():.2f}"
            gain = values.mean() - base
            print(f"| {words} | {way} | {cells} | {values.max():,.0f} | {gain:+.0f} |", flush=True)


def selection_table(largest: int) -> None:
    print(f"\n## K = 1 to {largest}, four starts each\n")
    rows, box = recorded("cut_in")
    start = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        chosen = select_components(rows, range(1, largest + 1), n_restarts=4, **box)
    seconds = time.process_time() - start
    words = f"{seconds:.0f} CPU seconds (bar 240)"
    print(f"{words}, K = {chosen.n_components} chosen, BIC {chosen.bic.min():,.0f}.", flush=True)


def memory_line(n: int) -> None:
    print(f"\n## Memory at N = {n:,}, d = 3, K = 9\n")
    command = [sys.executable, __file__, PEAK, str(n)]
    got = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    print(f"{got.strip()} MB above the {24 * n / 1e6:.0f} MB of data (bar 500).")


def peak(n: int) -> None:
    """Print what a fit needs above the data [MB]."""
    rows, box = synthetic(n)
    before = resident("VmRSS")
    fit(rows, box, max_iter=20)
    print(f"{resident('VmHWM') - before:.0f}")


def resident(field: str) -> float:
    """Memory of this process [MB], now or at its peak; not getrusage's, a child inherits that."""
    lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(field)) / 1e3


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true")
    parser.add_argument(PEAK, type=int)
    options = parser.parse_args()
    if options.peak:
        peak(options.peak)
        return
    quick = options.quick
    packages = ", ".join(f"{p} {version(p)}" for p in ("numpy", "scikit-learn"))
    print("# Mixture fits: time and memory\n")
    print(f"`python benchmarks/fit.py{' --quick' if quick else ''}`; one core, seconds of CPU.")
    print(f"Python {platform.python_version()}, {packages}; {platform.machine()}.\n")
    pass_table(3 if quick else 15)
    if RECORDED.exists():
        fit_table(1 if quick else 10)
        selection_table(2 if quick else 15)
    else:
        print("\nWhole fits: skipped, the recorded events are not at ../shared/data.")
    memory_line(100_000 if quick else 1_000_000)


if __name__ == "__main__":
    main()
