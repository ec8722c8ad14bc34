"""Does the demonstration's interval hold its own truth? One line a seed, resumable.

    python benchmarks/demo_coverage.py --seeds 1:21 --out demo.jsonl

For each seed: `crashrate demo`'s own pieces (synthetic events, fit, campaign), then a reference on
the *fitted* mixture by importance sampling with a million runs of the vehicle, drawn from
Gaussians fitted to the crashes of a first, wide draw, with defensive shares of traffic.
"""

import argparse
import json
import math
import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read by numpy's import

import numpy as np
import numpy.typing as npt

from crashrate.estimation.exploration import inflated
from crashrate.runs import demo, fitting, runner
from crashrate.runs.record import load_run
from crashrate.sampling.gaussians import fit_gaussians
from crashrate.sampling.pool import Blend, Density
from crashrate.traffic.model import TrafficModel

N_STEP, N_FIT, N_REFERENCE, N_BLOCKS = 200_000, 4000, 1_000_000, 10
Simulate = Callable[[np.ndarray], npt.ArrayLike]


def reference(
    traffic: TrafficModel, simulate: Simulate, crashes: np.ndarray, seed: int
) -> tuple[float, float]:
    """The crash probability under `traffic` and its standard error.

    Cross-entropy from the campaign's `crashes`: they say where to begin, the weights what is true.
    """
    rng = np.random.default_rng([seed, 20170501])
    aimed = _aimed(traffic, crashes, np.ones(len(crashes)), rng)
    for _ in range(3):
        x, z = contributions(traffic, simulate, aimed, N_STEP, rng)
        aimed = _aimed(traffic, x, z, rng)
    n = N_REFERENCE // N_BLOCKS
    means = [contributions(traffic, simulate, aimed, n, rng)[1].sum() / n for _ in range(N_BLOCKS)]
    return float(np.mean(means)), float(np.std(means, ddof=1) / math.sqrt(N_BLOCKS))


def _aimed(traffic: TrafficModel, x: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> Blend:
    """Gaussians fitted to draws `x` with weights `z`, widened, and defensive shares."""
    fitted = fit_gaussians(x[rng.choice(len(x), N_FIT, p=z / z.sum())], 12, rng)
    fitted = replace(fitted, covariances=1.5 * fitted.covariances)
    return Blend((0.8, 0.1, 0.1), (fitted, inflated(traffic, (1.0, 4.0)), traffic))


def contributions(
    traffic: TrafficModel, simulate: Simulate, proposal: Density, n: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """The draws inside the box and f/q for those that crash, 0 for the others."""
    x = proposal.sample(n, rng)
    x = x[traffic.contains(x)]
    weights = np.exp(traffic.log_density(x) - proposal.log_density(x))
    return x, weights * np.asarray(simulate(x), dtype=float)


def run_seed(seed: int) -> dict[str, object]:
    """One demonstration and its reference."""
    scenario, events = demo.demo_scenario(), demo.demo_events(seed)
    start = time.process_time()
    traffic = fitting.fit_traffic(scenario, events, (demo.N_COMPONENTS,), seed=seed, synthetic=True)
    fitted = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        got = runner.run(scenario, traffic, Path(folder) / "run", seed=seed)
        record = load_run(Path(folder) / "run")
    done = time.process_time()
    p, error = reference(traffic, scenario.simulator(), record.x[record.outcomes == 1], seed)
    low, high = got.interval
    return {
        "seed": seed,
        "calls": got.n_calls,
        "probability": got.probability,
        "interval": [low, high],
        "reference": p,
        "reference_se": error,
        "covered": low <= p <= high,
        "stop": got.stop_reason.name,
        "alarms": [alarm.name for alarm in got.alarms],
        "fit_seconds": round(fitted - start, 1),
        "campaign_seconds": round(done - fitted, 1),
    }


def table(records: list[dict]) -> str:
    """A Markdown table, a line a seed, and a line of totals."""
    lines = [
        "| seed | runs | estimate | 95 % interval | reference (± se) | held | fit, campaign [s] |",
        "|---|---|---|---|---|---|---|",
    ]
    for r in sorted(records, key=lambda r: r["seed"]):
        low, high = r["interval"]
        lines.append(
            f"| {r['seed']} | {r['calls']} | {r['probability']:.3g} | {low:.3g} – {high:.3g} "
            f"| {r['reference']:.4g} ± {100 * r['reference_se'] / r['reference']:.1f} % "
            f"| {'yes' if r['covered'] else 'no'} "
            f"| {r['fit_seconds']}, {r['campaign_seconds']} |"
        )
    ratio = np.array([r["probability"] / r["reference"] for r in records])
    se = ratio.std(ddof=1) / math.sqrt(len(ratio)) if len(ratio) > 1 else math.nan
    lines.append(
        f"\nheld {sum(r['covered'] for r in records)} of {len(records)}; "
        f"median {np.median([r['calls'] for r in records]):g} runs; "
        f"bias {100 * (ratio.mean() - 1):+.1f} ± {100 * se:.1f} %"
    )
    return "\n".join(lines)


def main() -> None:
    """Run what is missing, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", default="1:21", help="first:end, the end not included")
    parser.add_argument("--out", type=Path, default=Path("demo.jsonl"))
    arguments = parser.parse_args()
    first, end = (int(part) for part in arguments.seeds.split(":"))
    records = []
    if arguments.out.exists():
        lines = arguments.out.read_text(encoding="utf-8").splitlines()
        records = [json.loads(line) for line in lines]
    for seed in range(first, end):
        if seed in {r["seed"] for r in records}:
            continue
        records.append(run_seed(seed))
        with arguments.out.open("a", encoding="utf-8") as out:
            out.write(json.dumps(records[-1]) + "\n")
        print(records[-1], flush=True)
    print(table(records))


if __name__ == "__main__":
    main()
