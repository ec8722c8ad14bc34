"""The answer in a few short lines, for the head of the report."""

from crashrate.estimation.consequence import Consequence
from crashrate.estimation.estimate import Estimate, in_words
from crashrate.estimation.width import width_text
from crashrate.reports.evidence import accelerates
from crashrate.reports.numbers import interval_text, power_of_ten
from crashrate.runs.sections import Outcome

Figure = tuple[str, str]
"""A value and what it is."""


def key_figures(estimate: Estimate, outcome: Outcome) -> tuple[Figure, ...]:
    """The answer in three short lines or fewer; none where nothing is known."""
    if estimate.goal == "bounds":
        return _bounds(estimate, outcome) if estimate.bounds[0] > 0 else ()
    aimed = next((c for c in estimate.consequences if c.aimed and c.determined), None)
    if aimed is not None:
        return _of_consequence(estimate, aimed, outcome)
    if not estimate.probability > 0:
        return ()
    return _of_event(estimate, outcome)


def width(mean: float, interval: tuple[float, float]) -> str:
    """The interval's width over the mean; it does not break."""
    return width_text(mean, interval).replace(" %", "\u00a0%")


def _bounds(e: Estimate, outcome: Outcome) -> tuple[Figure, ...]:
    return (
        (
            f"{power_of_ten(e.bounds[0])} … {power_of_ten(e.bounds[1])}",
            f"bounds of P({outcome.event}) per {outcome.per}, if the risk order holds",
        ),
        (f"× {e.bounds_factor:.3g}", "upper over lower bound"),
        (f"{e.n_calls:,} runs", "of the simulator"),
    )


def _of_consequence(e: Estimate, aimed: Consequence, outcome: Outcome) -> tuple[Figure, ...]:
    return (
        (power_of_ten(aimed.mean), f"E({aimed.name}) per {outcome.per}: what was aimed at"),
        _interval(e, aimed.mean, aimed.interval),
        (f"{e.n_calls:,} runs", "of the simulator"),
    )


def _of_event(e: Estimate, outcome: Outcome) -> tuple[Figure, ...]:
    p, what = e.probability, f"P({outcome.event}) per {outcome.per}"
    if not e.determined:
        level, interval = f"{100 * e.confidence:g} % interval", interval_text(e.interval)
        return (
            (f"≤ {power_of_ten(e.interval[1])}", f"{what} is not determined: {level} {interval}"),
            (f"{e.n_calls:,} runs", "of the simulator"),
        )
    return (
        (power_of_ten(p), f"{what}: about one in {in_words(1 / p)}"),
        _interval(e, p, e.interval),
        (f"{e.n_calls:,} runs", _effort(e)),
    )


def _interval(e: Estimate, mean: float, interval: tuple[float, float]) -> Figure:
    level = f"{100 * e.confidence:g} % interval"
    return width(mean, interval), f"{level}, {interval_text(interval)}"


def _effort(e: Estimate) -> str:
    if not accelerates(e):
        return "of the simulator"
    calls = in_words(e.crude_monte_carlo_calls)
    return f"of the simulator, in place of {calls} by crude Monte Carlo"
