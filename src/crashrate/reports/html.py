"""The report: one HTML file that holds all it needs, for a reader who was not there."""

import re
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from crashrate.errors import StoreError
from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.estimation.consequence import Consequence
from crashrate.estimation.estimate import Estimate, in_words
from crashrate.reports.evidence import accelerates, evidence
from crashrate.reports.likeliest import likeliest_crashes
from crashrate.reports.numbers import interval_text, percent, power_of_ten
from crashrate.reports.panel import Panel
from crashrate.reports.recordings import check_of, sheets
from crashrate.reports.results import estimate_of
from crashrate.runs.record import RunRecord

if TYPE_CHECKING:
    from jinja2 import Template

# a number as the command line prints it: typeset, it does not break at the sign
_SCIENTIFIC = re.compile(r"\d\.\de[+-]\d\d")
TEMPLATE = "report.html.j2"


def write_report(record: RunRecord, path: str | Path) -> Path:
    """Write the report of `record` to `path`, the old file or the new one whole at any moment.

    Parameters
    ----------
    record : RunRecord
    path : str or Path
        The HTML file.

    Returns
    -------
    Path
        `path`.

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    path = Path(path)
    page = render_report(record)
    temporary = path.with_name(f"{path.name}.new")
    try:
        temporary.write_text(page, encoding="utf-8")
        temporary.replace(path)
    except OSError as error:
        raise StoreError(f"{path}: expected a file to write to, got: {error}.") from error
    return path


def render_report(record: RunRecord) -> str:
    """The report of `record` as one HTML page that loads nothing from elsewhere.

    Parameters
    ----------
    record : RunRecord
    """
    from plotly.offline import get_plotlyjs

    estimate = estimate_of(record.result)
    return _template().render(
        record=record,
        running=estimate.stop_reason is StopReason.RUNNING,
        outcome=record.scenario.outcome,
        estimate=estimate,
        sentence=_sentence(record, estimate),
        key_figures=_key_figures(record, estimate),
        consequences=_consequences(estimate),
        facts=evidence(record, estimate),
        panels=_panels(record, estimate),
        crashes=likeliest_crashes(record),
        sheets=sheets(record),
        all_alarms=tuple(Alarm),
        plotly_js=get_plotlyjs(),
    )


@cache
def _template() -> "Template":
    from jinja2 import Environment, PackageLoader, StrictUndefined

    from crashrate.reports.figures.style import to_div

    environment = Environment(
        loader=PackageLoader("crashrate.reports"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["to_div"] = to_div
    return environment.get_template(TEMPLATE)


def _sentence(record: RunRecord, estimate: Estimate) -> str:
    outcome = record.scenario.outcome
    sentence = record.result.get("sentence") or estimate.sentence(outcome.event, outcome.per)
    return _SCIENTIFIC.sub(lambda found: power_of_ten(float(found[0])), str(sentence))


def _key_figures(record: RunRecord, estimate: Estimate) -> tuple[tuple[str, str], ...]:
    """The answer in three short lines; none where there is no estimate."""
    p, outcome = estimate.probability, record.scenario.outcome
    if estimate.goal == "bounds" and estimate.bounds[0] > 0:
        return (
            (
                f"{power_of_ten(estimate.bounds[0])} … {power_of_ten(estimate.bounds[1])}",
                f"bounds of P({outcome.event}) per {outcome.per}, if the risk order holds",
            ),
            (f"× {estimate.bounds_factor:.3g}", "upper over lower bound"),
            (f"{estimate.n_calls:,} runs", "of the simulator"),
        )
    if not p > 0:
        return ()
    return (
        (power_of_ten(p), f"P({outcome.event}) per {outcome.per}: about one in {in_words(1 / p)}"),
        (
            _width(estimate),
            f"{100 * estimate.confidence:g} % interval, {interval_text(estimate.interval)}",
        ),
        (f"{estimate.n_calls:,} runs", _effort(estimate)),
    )


def _width(estimate: Estimate) -> str:
    """Half the interval over the estimate; its upper end where that is more than the estimate."""
    if estimate.relative_half_width <= 1:
        return f"± {percent(estimate.relative_half_width)}"
    return f"≤ {power_of_ten(estimate.interval[1])}"


def _consequences(estimate: Estimate) -> tuple[tuple[str, str, str, str, int], ...]:
    """Each consequence: name, mean, interval, share of the events' severity, runs that had it."""
    return tuple(
        (
            c.name + " (aimed at)" * c.aimed,
            power_of_ten(c.mean) if c.determined else "not determined",
            f"{interval_text(c.interval)}{_about(c)}",
            percent(c.mean / estimate.probability)
            if c.determined and estimate.probability > 0
            else "–",
            c.n_carrying,
        )
        for c in estimate.consequences
    )


def _about(c: Consequence) -> str:
    return f" (± {percent(c.relative_half_width)})" if c.determined else ""


def _effort(estimate: Estimate) -> str:
    if not accelerates(estimate):
        return "of the simulator"
    calls = in_words(estimate.crude_monte_carlo_calls)
    return f"of the simulator, in place of {calls} by crude Monte Carlo"


def _panels(record: RunRecord, estimate: Estimate) -> tuple[Panel, ...]:
    from crashrate.reports.figures.answers import answers_panel
    from crashrate.reports.figures.bic import bic_panel
    from crashrate.reports.figures.data import data_panel
    from crashrate.reports.figures.tails import tail_panels
    from crashrate.reports.learned_panels import learned_panels

    traffic, check = record.traffic, check_of(record)
    return (
        answers_panel(estimate, check),
        data_panel(record),
        bic_panel(traffic.provenance, len(traffic.weights)),
        *tail_panels(check),
        *learned_panels(record),
        *_convergence(record, estimate),
    )


def _convergence(record: RunRecord, estimate: Estimate) -> tuple[Panel, ...]:
    """The estimate over runs; nothing where the runs went into bounds."""
    from crashrate.reports.figures.convergence import estimate_panel, half_width_panel

    if estimate.goal == "bounds":
        return ()
    return estimate_panel(estimate), half_width_panel(estimate, _target(record))


def _target(record: RunRecord) -> float:
    target: dict[str, Any] = record.result.get("target") or {}
    return float(target.get("relative_half_width") or record.scenario.target.relative_half_width)
