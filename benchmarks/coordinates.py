"""In which coordinates to model a cut-in: likelihood, crash probability and severity ladder.

The recorded lane changes are fitted in several coordinates. The crash set is the vehicle itself
(the ACC + AEB plant without caps), so that nothing is learned and nothing is estimated from few
runs: probabilities are integrals of each fitted law, to a few per cent.

    python benchmarks/coordinates.py ../shared/data/spmd_lane_changes.parquet

Deviance and p-value are those of the ladder: small p refutes the law where crashes come from.
BIC is in units of (v, 1/R, 1/TTC), whatever is modelled.
"""

import sys
from dataclasses import dataclass

import numpy as np
import pyarrow.parquet as pq

from crashrate import datasets
from crashrate.estimation.exploration import inflated
from crashrate.events import EventTable
from crashrate.recordings.comparison import Comparison
from crashrate.recordings.expectation import Draws
from crashrate.recordings.ladder import Ladder, ladder
from crashrate.recordings.severity import Severity
from crashrate.sampling.gaussians import Gaussians
from crashrate.simulators import AccAeb
from crashrate.traffic.mixture import TruncatedGaussianMixture
from crashrate.traffic.model import TrafficModel
from crashrate.traffic.scales import Scales
from crashrate.variables import BoolArray, FloatArray

PLANT = AccAeb()
LOWER, UPPER = (5.0, 1 / 75, 0.0), (35.0, np.inf, np.inf)


@dataclass(frozen=True)
class Coordinates:
    """Variables v, 1/R and a third, closing speed or 1/TTC, each on a scale."""

    closing: str
    scales: tuple[str, str, str]
    n_components: int

    @property
    def name(self) -> str:
        """As the table shows it."""
        names = ("v", "1/R", "c" if self.closing == "closing_speed" else "1/TTC")
        return ", ".join(
            f"log {n}" if s == "log" else n for n, s in zip(names, self.scales, strict=True)
        )

    def rows(self, recorded: FloatArray) -> FloatArray:
        """(v, 1/R, 1/TTC) to these variables."""
        if self.closing == "inv_ttc":
            return recorded
        return np.column_stack([recorded[:, :2], recorded[:, 2] / recorded[:, 1]])

    def crashes(self, x: FloatArray) -> BoolArray:
        """By the vehicle itself."""
        gap = 1 / x[:, 1]
        closing = x[:, 2] if self.closing == "closing_speed" else x[:, 2] * gap
        return PLANT.run(v_lead=x[:, 0], range=gap, closing_speed=closing).crash


CHOICES = (
    Coordinates("closing_speed", ("linear", "log", "linear"), 10),
    Coordinates("closing_speed", ("linear", "linear", "linear"), 10),
    Coordinates("inv_ttc", ("linear", "linear", "linear"), 13),
    Coordinates("inv_ttc", ("linear", "log", "linear"), 10),
    Coordinates("closing_speed", ("linear", "log", "log"), 10),
    Coordinates("inv_ttc", ("linear", "log", "log"), 10),
)


@dataclass(frozen=True)
class Vehicle:
    """The vehicle itself in the place of what a campaign learned."""

    coordinates: Coordinates
    scales: Scales
    proposal: Gaussians

    def __call__(self, z: FloatArray) -> FloatArray:
        """1 for a crash, 0 for none."""
        return self.coordinates.crashes(self.scales.back(z)).astype(float)


def fitted(choice: Coordinates, x: FloatArray) -> tuple[TrafficModel, float]:
    fit = TruncatedGaussianMixture(
        choice.n_components, lower=LOWER, upper=UPPER, scales=choice.scales, n_init=2,
        random_state=0,
    ).fit(x)  # fmt: skip
    return fit.traffic_model(("v_lead", "inv_range", choice.closing)), fit.bic_


def compared(choice: Coordinates, model: TrafficModel, x: FloatArray) -> tuple[Draws, Ladder]:
    modelled = model.modelled
    vehicle = Vehicle(choice, model.scales, inflated(modelled, (16.0,)))
    events = EventTable(model.names, x, "recorded", np.arange(len(x)))
    severity = Severity.multiplying(choice.closing, model.names)
    c = Comparison(events, model, vehicle, severity, seed=0)
    draws = c.draws(modelled, 0)
    steps = ladder(c.levels, c.first, draws.probabilities, np.empty((0, 5)), c.rng(1))
    return draws, steps


def row(choice: Coordinates, model: TrafficModel, bic: float, x: FloatArray) -> str:
    draws, steps = compared(choice, model, x)
    expected = " ".join(f"{e:.3g}" for e in steps.expected)
    observed = " ".join(map(str, steps.observed))
    p, se = draws.probabilities[0], draws.standard_errors[0]
    return (
        f"| {choice.name} | {model.n_components} | {bic:,.0f} | {p:.2e} ± {100 * se / p:.0f} % | "
        f"{expected} | {observed} | {steps.deviance:.1f} | {steps.p_value:.2g} |"
    )


def main(path: str) -> None:
    table = pq.read_table(path)
    recorded = np.column_stack(
        [table[name].to_numpy().astype(float) for name in ("v_lead", "inv_range", "inv_ttc")]
    )
    recorded = np.clip(recorded, LOWER, UPPER)  # single precision: 0.0133333 is a range of 75 m
    print("| modelled | K | BIC | P(crash) | expected at × 1, 1.3, 1.5, 2, 2.5 | observed | "
          "deviance | p |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|")
    for choice in CHOICES:
        x = choice.rows(recorded)
        model, bic = fitted(choice, x)
        if choice.closing == "closing_speed":  # a density of c is one of 1/TTC times R
            bic += 2 * np.log(recorded[:, 1]).sum()
        print(row(choice, model, bic, x), flush=True)
    published = Coordinates("inv_ttc", ("linear",) * 3, 9)
    model = datasets.spmd_mixture()
    bic = -2 * model.log_density(recorded).sum() + np.log(len(recorded)) * (10 * 9 - 1)
    print(row(published, model, bic, recorded).replace("| v, ", "| published parameters: v, "))


if __name__ == "__main__":
    main(sys.argv[1])
