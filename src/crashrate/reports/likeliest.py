"""The simulated crashes that traffic makes likeliest: what an engineer looks at first."""

import csv
import io
from dataclasses import dataclass

import numpy as np

from crashrate.reports.axes import Axis, units_of, variable_axes
from crashrate.reports.numbers import percent
from crashrate.runs.record import RunRecord
from crashrate.variables import FloatArray

N_CRASHES = 10


@dataclass(frozen=True)
class CrashTable:
    """The likeliest crashes.

    Parameters
    ----------
    headings : tuple of Axis
        Variables, then derived quantities.
    rows : tuple of (run number, relative density, cells)
        Texts, likeliest first.
    csv : str
        The variables to full precision, to run them again.
    """

    headings: tuple[Axis, ...]
    rows: tuple[tuple[int, str, tuple[str, ...]], ...]
    csv: str


def by_density(record: RunRecord, *, crash: bool) -> np.ndarray:
    """Indices of the simulated crashes (or safe runs), those of highest traffic density first."""
    found = np.flatnonzero(record.outcomes == (1 if crash else 0))
    if not len(found):
        return found
    return found[np.argsort(-record.traffic.average.log_density(record.x[found]), kind="stable")]


def likeliest_crashes(record: RunRecord) -> CrashTable:
    """The ten simulated crashes of highest traffic density."""
    scenario = record.scenario
    chosen = by_density(record, crash=True)[:N_CRASHES]
    x = record.x[chosen]
    units = units_of(scenario)
    headings = (*variable_axes(scenario), *(Axis(n, units[n]) for n in scenario.derived))
    columns = [*x.T, *(np.asarray(e(x)) for e in scenario.derived.values())]
    density = _relative(record.traffic.average.log_density(x)) if len(x) else np.empty(0)
    rows = tuple(
        (int(i) + 1, percent(float(density[k])), tuple(_cell(float(c[k])) for c in columns))
        for k, i in enumerate(chosen)
    )
    return CrashTable(headings, rows, _csv(scenario.names, x))


def _cell(value: float) -> str:
    return f"{value:#.5g}"


def _relative(log_density: FloatArray) -> FloatArray:
    return np.asarray(np.exp(log_density - log_density.max()))


def _csv(names: tuple[str, ...], x: FloatArray) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows(x.tolist())
    return text.getvalue()
