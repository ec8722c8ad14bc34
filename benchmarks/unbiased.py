"""Is one round unbiased given the past? Redrawn many times against the truth of its own pool.

    python benchmarks/unbiased.py --problem A C "disc, wrong order" --seeds 0:5

A round's pool has a crash mass of its own, Σ w y, which these problems tell for nothing. Whatever
surrogate and order hold, the mean over redrawn rounds must be that mass. Beside it stand controls
that must fail: weights that forget how the runs were drawn, the surrogate's sum trusted as the
truth, and what the order implies trusted without a run (on problems whose order is false).
"""

import argparse
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one thread a process; read by numpy's import

import numpy as np

import crashrate
from crashrate.estimation import rounds, sequential
from crashrate.estimation.selection import Drawn, to_estimate
from crashrate.estimation.view import View
from problems import PROBLEMS
from study import seeds

N_DRAWS, TIMES = 6, 2000
ALLOWED = 4.0  # standard errors


@dataclass(frozen=True)
class Redrawn:
    """Mean of the redrawn estimates over the pool's crash mass, and its standard error."""

    ratio: float
    error: float

    @property
    def z(self) -> float:
        """Standard errors by which the mean is off."""
        return (self.ratio - 1) / max(self.error, 1e-12)


@contextmanager
def spied(seen: list[tuple[View, rounds.Round]]) -> Iterator[None]:
    """Keep every estimating round in `seen`, with the view that it was drawn from."""

    def measure(view: View, drawn: Drawn, outcomes: Any) -> rounds.Round:
        found = rounds.measure(view, drawn, outcomes)
        seen.append((view, found))
        return found

    original, sequential.measure = sequential.measure, measure
    try:
        yield
    finally:
        sequential.measure = original


def redrawn(view: View, truth: np.ndarray, rng: np.random.Generator, how: str) -> Redrawn:
    """The round of `view` many times over, as it is or as a control spoils it."""
    drawn_from = view
    if how == "order trusted":  # no run where the order implies the outcome, and no correction
        decided = view.inner | view.safe
        drawn_from = replace(view, h=np.where(decided, view.inner.astype(float), view.h))
        found = [_decided(drawn_from, decided, truth, rng) for _ in range(TIMES)]
    elif how == "surrogate trusted":
        found = [view.probability] * TIMES
    else:
        found = [_once(view, truth, rng, forget=how == "weights forgotten") for _ in range(TIMES)]
    mass = float(view.weights @ truth)
    estimates = np.array(found) / mass
    return Redrawn(float(estimates.mean()), float(estimates.std(ddof=1)) / math.sqrt(TIMES))


def _once(view: View, truth: np.ndarray, rng: np.random.Generator, *, forget: bool) -> float:
    drawn = to_estimate(view, N_DRAWS, rng)
    told = drawn
    if forget:
        even = np.full(len(view.h), 1 / len(view.h))
        told = replace(drawn, probabilities=even)
    return rounds.measure(view, told, truth[drawn.rows]).estimate


def _decided(view: View, decided: np.ndarray, truth: np.ndarray, rng: np.random.Generator) -> float:
    drawn = to_estimate(view, N_DRAWS, rng)
    outcomes = np.where(decided[drawn.rows], view.h[drawn.rows], truth[drawn.rows])
    return rounds.measure(view, drawn, outcomes).estimate


HOWS = ("as it is", "weights forgotten", "surrogate trusted", "order trusted")


def study(name: str, seed: int) -> dict[str, list[Redrawn]]:
    """Every estimating round of a campaign, redrawn, by how it was spoilt."""
    problem, seen = PROBLEMS[name](), []
    with spied(seen):
        crashrate.estimate(
            problem.crash, problem.traffic, risk=problem.risk, seed=seed, max_calls=400
        )
    rng = np.random.default_rng(seed)
    chosen = [view for view, _ in seen[:: max(len(seen) // 3, 1)]]
    truths = [np.asarray(problem.crash(v.pool.x), dtype=float) for v in chosen]
    return {
        how: [redrawn(v, y, rng, how) for v, y in zip(chosen, truths, strict=True)] for how in HOWS
    }


def row(name: str, how: str, found: list[Redrawn]) -> str:
    """One row of the table."""
    z = np.array([f.z for f in found])
    ratios = np.array([f.ratio for f in found])
    beyond = int((np.abs(z) > ALLOWED).sum())
    return (
        f"| {name} | {how} | {len(found)} | {100 * (ratios.mean() - 1):+.2f} % "
        f"| {100 * (ratios.min() - 1):+.1f} … {100 * (ratios.max() - 1):+.1f} % | {beyond} |"
    )


HEAD = (
    "| problem | round | rounds | mean error | least … largest | beyond 4 standard errors |\n"
    "|---|---|---|---|---|---|"
)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--problem", nargs="+", choices=PROBLEMS, required=True, metavar="NAME")
    parser.add_argument("--seeds", type=seeds, default=range(5), help="first:last+1")
    options = parser.parse_args()
    print(HEAD)
    for name in options.problem:
        studies = [study(name, seed) for seed in options.seeds]
        for how in HOWS:
            print(row(name, how, [f for s in studies for f in s[how]]), flush=True)


if __name__ == "__main__":
    main()
