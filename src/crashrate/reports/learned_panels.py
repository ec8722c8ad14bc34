"""The panels of the learned set: in space or plane, in sections, or the runs alone."""

from crashrate.reports.dominating import dominating_points
from crashrate.reports.figures.learned_set import (
    DominatingPoints,
    counts_text,
    plane_plot,
    space_plot,
)
from crashrate.reports.figures.runs import line_plot, runs_plots
from crashrate.reports.figures.section import NEAR, section_plots
from crashrate.reports.learned import Learned, learned_set, order_dropped
from crashrate.reports.panel import Panel
from crashrate.runs.record import RunRecord

_KEY = "learned"
_TITLE = "What the runs say about the crash set"
_READING = (
    "Through the declared risk order, a crash implies that everything riskier crashes (inner set), "
    "and a safe run that everything less risky is safe; between the two, nothing is implied."
)


def learned_panels(record: RunRecord) -> tuple[Panel, ...]:
    """The learned set, or the runs alone where no order is declared."""
    if not len(record.x):
        return (Panel(_KEY, _TITLE, "No simulator run yet."),)
    learned = learned_set(record)
    if learned is None:
        why = (
            "The declared risk order was dropped"
            if order_dropped(record)
            else "No risk order is declared"
        )
        text = f"The simulator runs. {why}, so that they imply nothing about other situations."
        return (Panel(_KEY, _TITLE, text, runs_plots(record)),)
    if len(learned.axes) == 1:
        return (Panel(_KEY, _TITLE, _line_caption(learned), (line_plot(learned),), wide=True),)
    dominating, remark = _dominating(record, learned)
    caption = f"{_READING} Found: {counts_text(learned)}. {remark}{_contradictions(learned)}"
    if len(learned.axes) == 2:
        plot = plane_plot(learned, dominating)
        return (Panel(_KEY, _TITLE, f"{caption} {_directions(learned)}", (plot,), wide=True),)
    space = Panel(
        _KEY,
        _TITLE,
        f"{caption} {_directions(learned)} Turn the figure by dragging it; click a name in the "
        "legend to hide it. Points far outside the view are left out.",
        (space_plot(learned, dominating),),
        wide=True,
    )
    sections = Panel("sections", "Sections of the learned set", _section_caption(learned),
                     section_plots(learned))  # fmt: skip
    return (space, sections)


def _dominating(record: RunRecord, learned: Learned) -> tuple[DominatingPoints, str]:
    s = learned.monotone
    inner = dominating_points(record.traffic, learned.order, s.minimal_crashes)
    outer = dominating_points(record.traffic, learned.order, s.corners)
    if inner is None or outer is None:
        return DominatingPoints(), (
            "Dominating points are not drawn: a risk coordinate's level sets are not flat in the "
            "variables. "
        )
    return DominatingPoints(inner, outer), (
        "A dominating point is where one component of the traffic model is densest in a set; each "
        "component has one in the inner and one in the outer set, where these are not empty. "
        "Corners without a bound lie on "
        "the edge of the view. "
    )


def _directions(learned: Learned) -> str:
    return "Declared: " + "; ".join(f"{a.name}, {a.riskier}" for a in learned.axes) + "."


def _contradictions(learned: Learned) -> str:
    n = learned.monotone.contradictions
    if not n:
        return "No outcome contradicts the order."
    return f"{n} outcomes contradict the order and imply nothing."


def _line_caption(learned: Learned) -> str:
    return (
        f"{_READING} Shaded: implied to crash (red), implied safe (blue). "
        f"{_directions(learned)} {_contradictions(learned)}"
    )


def _section_caption(learned: Learned) -> str:
    through = "likeliest simulated crash" if learned.reference_is_crash else "likeliest run"
    if learned.reference_is_crash and learned.monotone.contradictions:
        through += " that no outcome contradicts"
    return (
        f"Two risk coordinates at a time, the others held at the {through}; the value stands above "
        "each section. Shaded red: implied to crash; blue: implied safe; pale: undecided. Runs "
        f"within {100 * NEAR:g} % of the view from the section are drawn: crosses crashed, circles "
        "did not. A circle on red, or a cross on blue, lies a little off the section"
        f"{' or contradicts the order' if learned.monotone.contradictions else ''}."
    )
