"""The report: one HTML file that holds all it needs, for a reader who was not there."""

import re
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from crashrate.errors import StoreError
from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.estimation.consequence import Consequence
from crashrate.estimation.estimate import Estimate
from crashrate.reports.evidence import evidence
from crashrate.reports.key_figures import key_figures, width
from crashrate.reports.learned import order_dropped
from crashrate.reports.likeliest import likeliest_crashes
from crashrate.reports.numbers import interval_text, percent, power_of_ten
from crashrate.reports.panel import Panel
from crashrate.reports.recordings import check_of, sheets
from crashrate.reports.results import estimate_of
from crashrate.runs.looked_at import why_not_looked_at
from crashrate.runs.notes import notes
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
        sentences=_sentences(record, estimate),
        key_figures=key_figures(estimate, record.scenario.outcome),
        consequences=_consequences(estimate),
        facts=evidence(record, estimate),
        panels=_panels(record, estimate),
        crashes=likeliest_crashes(record),
        sheets=sheets(record),
        order_dropped=order_dropped(record),
        notes=tuple(f"{note[0].upper()}{note[1:]}." for note in notes(record.result)),
        unchecked=why_not_looked_at(record.result),
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


def _sentences(record: RunRecord, estimate: Estimate) -> tuple[str, ...]:
    """What was aimed at, first; then the event."""
    outcome = record.scenario.outcome
    event = record.result.get("sentence") or estimate.sentence(outcome.event, outcome.per)
    aimed = (c.sentence(outcome.per) for c in estimate.consequences if c.aimed)
    return tuple(_typeset(str(text)) for text in (*aimed, event))


def _typeset(sentence: str) -> str:
    return _SCIENTIFIC.sub(lambda found: power_of_ten(float(found[0])), sentence)


def _consequences(estimate: Estimate) -> tuple[tuple[str, str, str, str, int], ...]:
    """Each consequence: name, mean, interval, share of the events' severity, runs that had it."""
    return tuple(
        (
            c.name + " (aimed at)" * c.aimed,
            power_of_ten(c.mean) if c.determined else "not determined",
            f"{interval_text(c.interval)}{_about(c)}",
            percent(c.mean / estimate.probability) if c.determined and estimate.determined else "–",
            c.n_carrying,
        )
        for c in estimate.consequences
    )


def _about(c: Consequence) -> str:
    about = width(c.mean, c.interval) if c.determined else ""
    return about and f" ({about})"


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
