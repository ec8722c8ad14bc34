"""What the commands print: answers and tables on standard output, doubts on standard error."""

import json
import math
from collections.abc import Iterable, Mapping
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from crashrate.estimation.campaign import Campaign
    from crashrate.traffic.model import TrafficModel

_ROUNDING = 1e-9
UNFINISHED = "Not finished; the same `run` command goes on."
RUNNING = "Not finished; a process is at it now."


class Format(StrEnum):
    """What is printed on standard output."""

    TEXT = "text"
    JSON = "json"


def show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    """A warning on standard error; takes what `warnings.showwarning` is given."""
    typer.echo(f"Warning: {message}", err=True)


def print_result(result: dict[str, Any], output: Format) -> None:
    """The answer on standard output: one sentence, or the JSON; doubts beside it."""
    if output is Format.JSON:
        typer.echo(json.dumps(result, indent=2, ensure_ascii=False))
        return
    _print_answers(result)
    _print_doubts(result)


def _print_answers(result: Mapping[str, Any]) -> None:
    """What was aimed at, the event's probability, what else it leads to, and what was found."""
    consequences = result.get("consequences", ())
    _print_consequences([c for c in consequences if c["aimed"]])
    typer.echo(result["sentence"])
    _print_consequences([c for c in consequences if not c["aimed"]])
    if audit := result.get("order_audit"):
        typer.echo(audit["sentence"])
    if traffic_range := result.get("traffic_range"):
        typer.echo(traffic_range["sentence"])
    for sentence in (result.get("recordings") or {}).get("sentences", ()):
        typer.echo(sentence)


def _print_consequences(found: Iterable[Mapping[str, Any]]) -> None:
    """Each with what the traffic models make of it, where the runs determine it."""
    for consequence in found:
        typer.echo(consequence["sentence"])
        if (among := consequence.get("traffic_range")) and consequence["determined"]:
            typer.echo(among["sentence"])


def _print_doubts(result: Mapping[str, Any]) -> None:
    """How the run stands, and its alarms, on standard error."""
    from crashrate.estimation.alarms import StopReason
    from crashrate.runs.notes import notes

    if result["synthetic"]:
        typer.echo(
            "Synthetic: the traffic model was fitted to drawn, not recorded, events.", err=True
        )
    typer.echo(_how_it_stands(result) + _what_was_asked(result), err=True)
    if result["stop_reason"] == StopReason.BUDGET_ENDED.value:
        typer.echo("The same command with a larger --max-calls goes on from here.", err=True)
    if result["stop_reason"] == StopReason.DRAWS_ENDED.value:
        typer.echo(
            "Most of these draws cost no run, and their number is fixed: a larger --max-calls "
            "changes nothing.",
            err=True,
        )
    for note in notes(result):
        typer.echo(f"Note: {note}.", err=True)
    for alarm in result["alarms"]:
        typer.echo(f"Alarm: {alarm['message']}.", err=True)
    if found := result.get("order_suspect"):
        typer.echo(f"Note: {found['sentence']}.", err=True)


def _how_it_stands(result: Mapping[str, Any]) -> str:
    from crashrate.estimation.alarms import StopReason

    if result.get("running"):  # said by status alone
        return f"{RUNNING} The last outcome came {_ago(result['seconds_since_stored'])} ago."
    unfinished = result["stop_reason"] == StopReason.RUNNING.value
    return UNFINISHED if unfinished else f"Stopped: {result['stop_reason']}."


def _what_was_asked(result: Mapping[str, Any]) -> str:
    """The target and the budget; nothing of a run by an earlier version that does not say."""
    if not (target := result.get("target")):
        return ""
    about = f" for {target['aim']}" if target.get("aim") else ""
    told = result["n_calls"]
    taken = max(told, result.get("n_stored", told))  # said by status alone
    behind = f" The answer above is of the first {told:,} of them." if taken > told else ""
    return (
        f" Target ± {100 * target['relative_half_width']:.3g} %{about}, "
        f"{taken:,} of at most {target['max_calls']:,} runs taken.{behind}"
    )


def _ago(seconds: float) -> str:
    """A time that passed, in words of one unit."""
    for unit, size in (("hours", 7200), ("minutes", 120)):
        if seconds >= size:
            return f"{2 * seconds / size:.0f} {unit}"
    return f"{seconds:.0f} seconds"


def print_fit(model: "TrafficModel") -> None:
    """How the number of components was chosen, and how sound the fit that was kept is."""
    events = model.provenance.get("events") or {}
    if twins := events.get("n_duplicates"):
        typer.echo(
            f"{twins:,} of the {events['n']:,} events equal an earlier one in every digit; each "
            "counts as an event of its own."
        )
    print_selection(model.provenance["selection"])
    _print_kept(model)


def print_selection(selection: Mapping[str, Any]) -> None:
    """The table of the numbers of components that were tried; nothing where it was one.

    Parameters
    ----------
    selection : mapping
        Of a traffic model's provenance.
    """
    numbers, bic = selection["n_components"], selection["bic"]
    if selection["left_out"]:
        show_warning(f"no fit with {_listed(selection['left_out'])} components: every start failed")
    if len(numbers) == 1:
        return
    columns = [_bic_column(selection), *_held_out_columns(selection)]
    for n, *cells in zip(["components", *numbers], *columns, strict=True):
        typer.echo(f"{n:>10}" + "".join(cells).rstrip())
    if selection["held_out"]:
        typer.echo(_HELD_OUT)
    if len(near := selection["admissible"]) > 1:
        typer.echo(
            f"The number of components is not identified: BIC does not tell {_listed(near)} apart."
        )
    if bic[-1] == min(bic):
        show_warning(
            f"BIC is lowest at {numbers[-1]}, the most components that were tried: more may fit "
            "better; raise the end of --components."
        )


_HELD_OUT = (
    "Held out: log likelihood of a fifth of the events under a fit of the others, per 1000\n"
    "events, below the highest; median over starts, each with a split of its own."
)


def _bic_column(selection: Mapping[str, Any]) -> list[str]:
    """The criterion of the best starts, and how far the others are."""
    several = len(selection["bic_restarts"][0]) > 1
    lines = ["           BIC" + "  spread over starts" * several + " " * 8]
    for bic, starts in zip(selection["bic"], selection["bic_restarts"], strict=True):
        spread = f"{_range(starts):20.1f}" * several
        mark = "lowest" if bic == min(selection["bic"]) else ""
        lines.append(f"{bic:14.1f}{spread}  {mark:6}")
    return lines


def _held_out_columns(selection: Mapping[str, Any]) -> list[list[str]]:
    """The gain on events not seen, median and spread over splits; none where it was not asked."""
    from crashrate.traffic.held_out import held_out_gains, medians

    if not selection["held_out"]:
        return []
    gains = held_out_gains(selection["held_out"])
    several = gains.shape[1] > 1
    lines = ["    held out" + "  spread over splits" * several]
    for median, splits in zip(medians(gains), gains.tolist(), strict=True):
        spread = f"{_range(splits):20.2f}" * several
        mark = "highest" if abs(median) < _ROUNDING else ""  # the gains' scale says so
        lines.append(f"{median:z12.2f}{spread}  {mark}")
    return [lines]


def _print_kept(model: "TrafficModel") -> None:
    """One line on the fit that was kept; a warning where it needed more prior than it was given."""
    from crashrate.traffic.mixture import PRIOR_STRENGTH

    prior, promise = model.provenance["prior_strength"], model.provenance["promise"]
    typer.echo(
        f"Kept fit: at least {100 * model.component_masses.min():.2g} % of every component lie in "
        f"the box, prior worth {prior:g} event{'s' if prior != 1 else ''}, {_converged(promise)}."
    )
    if prior > PRIOR_STRENGTH:
        show_warning(
            f"the prior had to be raised from {PRIOR_STRENGTH:g} to {prior:g} events, for "
            "components ran out of the box; give fewer --components."
        )


def _converged(promise: float) -> str:
    """How far the fit's log likelihood is from its maximum, per event."""
    return f"log likelihood within {promise:.0e} of its maximum per event"


def _range(values: Iterable[float | None]) -> float:
    """Largest less smallest of the numbers that are there."""
    there = [x for x in values if x is not None and not math.isnan(x)]
    return max(there) - min(there) if there else math.nan


def _listed(numbers: Iterable[int]) -> str:
    return ", ".join(map(str, numbers))


def runs(n: int, word: str) -> str:
    """A number of things, in the plural where they are several."""
    return f"{n} {word}" if n == 1 else f"{n} {word}s"


def standing(campaign: "Campaign", n_stored: int = 0) -> str:
    """How a campaign stands, on one line of progress; the first `n_stored` runs are not new."""
    snapshot, calls, problem = campaign.snapshot, campaign.n_calls, campaign.problem
    taken = f"{calls:,} of at most {problem.max_calls:,} runs"
    if calls <= n_stored:
        taken = f"going through {calls:,} of {n_stored:,} stored runs"
    failed = f", {campaign.n_failed} failed" * (campaign.n_failed > 0)
    text = f"{taken}{failed}, {snapshot.phase}"
    target = f"(target ± {100 * problem.relative_half_width:.3g} %)"
    if campaign.goal == "bounds":
        low, high = snapshot.bounds
        return f"{text}: {low:.1e} ≤ P ≤ {high:.1e} {target}" if low > 0 else text
    aimed = next((c for c in snapshot.consequences if c.aimed), None)
    number = snapshot.probability if aimed is None else aimed.mean
    if not number > 0:
        return text
    low, high = snapshot.interval if aimed is None else aimed.interval
    relative, name = (high - low) / 2 / number, "P" if aimed is None else f"E({aimed.name})"
    # upper ends far above the estimate stand for little seen so far: a percentage says less
    around = f"± {100 * relative:.3g} %" if relative <= 1 else f"in [{low:.1e}, {high:.1e}]"
    met = ", met: what it rests on is checked" * (relative <= problem.relative_half_width)
    return f"{text}: {name} = {number:.2e} {around} {target[:-1]}{met})"
