"""The command line: arguments to public API, nothing else.

What a command needs is imported inside it, so that ``crashrate --help`` answers at once.
"""

import functools
import sys
import warnings
from collections.abc import Callable
from contextlib import redirect_stdout
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from crashrate.errors import InvalidInputError
from crashrate.exits import ERROR, TARGET_NOT_MET, plain_errors
from crashrate.printing import Format, print_fit, print_result, runs, show_warning, standing
from crashrate.runs.progress import progress

if TYPE_CHECKING:
    from crashrate.estimation.estimate import Estimate

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
Command = TypeVar("Command", bound=Callable[..., None])


class Method(StrEnum):
    """How the probability is estimated."""

    SEQUENTIAL = "sequential"
    HUANG2017 = "huang2017"
    CRUDE = "crude"
    CROSS_ENTROPY = "cross-entropy"


Goal = StrEnum("Goal", ["PROBABILITY", "BOUNDS"])  # what the simulator runs are spent on


# --- arguments


def _half_width(value: float | None) -> float | None:
    from crashrate.estimation.strategy import HALF_WIDTH

    if value is not None and not 0 < value <= 1:
        raise typer.BadParameter(f"expected {HALF_WIDTH}, got {value}.")
    return value


def _components(text: str) -> str:
    from crashrate.runs.fitting import parse_components

    try:
        parse_components(text)
    except InvalidInputError as error:
        raise typer.BadParameter(str(error).removeprefix("components: ")) from None
    return text


ScenarioFile = Annotated[Path, typer.Argument(metavar="SCENARIO", help="Scenario file (TOML).")]
RunFolder = Annotated[Path, typer.Argument(metavar="DIR", help="Run folder.")]
Seed = Annotated[int, typer.Option(min=0, help="Equal ones give equal answers on a processor.")]
OutputFormat = Annotated[Format, typer.Option("--format", help="What standard output shows.")]


# --- commands


def _examples(*lines: str) -> str:
    """Examples below the help of a command, one to a line."""
    return "\n  ".join(("\b\nExamples:", *lines))


def _version(show: bool) -> None:
    if show:
        from crashrate import __version__

        typer.echo(f"crashrate {__version__}")
        raise typer.Exit


@app.callback(
    epilog=_examples(
        "crashrate demo",
        "crashrate fit events.parquet --scenario examples/cut_in.toml --out traffic.json",
        "crashrate run examples/cut_in.toml --traffic traffic.json --out runs/first --seed 1",
    )
)
def _crashrate(
    ctx: typer.Context,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
    version: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """How often would this automated vehicle crash in ordinary traffic?

    A probability, an honest interval and the evidence, from a few hundred simulator runs.

    Exit codes: 0 target met, 3 budget ended first, 2 wrong usage, 1 error, 130 interrupted.
    """
    del version
    ctx.obj = debug


def _command(*examples: str) -> Callable[[Command], Command]:
    """Register a command whose errors are one line on standard error, never a traceback."""

    def register(function: Command) -> Command:
        @functools.wraps(function)
        def plainly(ctx: typer.Context, **arguments: Any) -> None:
            with warnings.catch_warnings(), plain_errors(debug=ctx.obj):
                warnings.showwarning = show_warning
                function(ctx, **arguments)

        app.command(epilog=_examples(*examples))(plainly)
        return function

    return register


@_command(
    "crashrate fit events.parquet --scenario examples/huang2017.toml --components 9 --out t.json",
    "crashrate fit events.csv --scenario examples/cut_in.toml --components 1:15 --out t.json",
    "crashrate fit events.csv --scenario examples/cut_in.toml --ensemble 0 --out t.json",
)
def fit(
    ctx: typer.Context,
    *,
    events: Annotated[
        Path, typer.Argument(metavar="EVENTS", help="Table of events: .csv, .parquet or .mat.")
    ],
    scenario: Annotated[Path, typer.Option(help="Scenario file (TOML).")],
    out: Annotated[Path, typer.Option(help="Traffic model to write (JSON).")],
    components: Annotated[
        str,
        typer.Option(callback=_components, help="A number, a range such as 1:15, or auto (1:15)."),
    ] = "auto",
    ensemble: Annotated[
        int,
        typer.Option(
            min=0,
            help="Further fits, to re-weighted events, that say what the events leave open.",
        ),
    ] = 40,
    restarts: Annotated[int, typer.Option(min=1, help="Starts for each number of components.")] = 4,
    workers: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Processes; the result does not depend on it.",
            show_default="the cores there are, at most 8; fewer for few events",
        ),
    ] = None,
    seed: Seed = 0,
    drop_invalid: Annotated[
        bool, typer.Option("--drop-invalid", help="Drop and count bad rows, do not refuse them.")
    ] = False,
) -> None:
    """Fit a traffic model to recorded events."""
    del ctx
    from crashrate.runs import fitting, recorded
    from crashrate.runs.places import require_file_place, require_replaceable
    from crashrate.runs.scenario import Scenario

    require_file_place(out)
    require_replaceable(out)
    recorded.require_replaceable_events(out, events)
    what = Scenario.from_file(scenario)
    table = fitting.read_scenario_events(what, events, drop_invalid=drop_invalid)
    numbers = fitting.tried(components, table)
    fitting.require_enough(table, numbers, events)
    typer.echo(table.summary())
    with progress() as say:
        model = fitting.fit_traffic(
            what,
            table,
            numbers,
            seed=seed,
            n_restarts=restarts,
            n_members=ensemble,
            workers=workers,
            on_step=lambda done, total, message: say(f"{done} of {total} fits done: {message}"),
        )
    out.parent.mkdir(parents=True, exist_ok=True)
    recorded.write_events(out, table)
    model.to_json(out)
    print_fit(model)
    if warning := fitting.thin_data(len(table), model.n_components, model.n_variables):
        show_warning(warning)
    names = ", ".join(model.names)
    further = len(model.members) - 1  # the model is the first of its members
    members = f", with {runs(further, 'further fit')}" if further > 0 else ""
    components = runs(model.n_components, "truncated normal component")
    typer.echo(f"{out}: {components} in {names}{members}")


@_command(
    "crashrate run examples/huang2017.toml --traffic published --out runs/published --seed 1",
    "crashrate run examples/cut_in.toml --traffic traffic.json --out runs/cut_in --format json",
    "crashrate run examples/cut_in.toml --traffic traffic.json --out runs/cut_in --max-calls 5000",
)
def run(
    ctx: typer.Context,
    *,
    scenario: ScenarioFile,
    traffic: Annotated[
        str, typer.Option(metavar="published|FILE", help="Traffic model: 'published', or JSON.")
    ],
    out: Annotated[Path, typer.Option(help="Run folder; one that is there is continued.")],
    seed: Seed = 0,
    method: Annotated[
        Method | None,
        typer.Option(
            help="How to estimate; all but 'sequential' are there to be compared with.",
            show_default="the scenario's, or sequential",
        ),
    ] = None,
    relative_half_width: Annotated[
        float | None,
        typer.Option(
            callback=_half_width,
            metavar="SHARE",
            help="Target: half the interval over the estimate, 0.1 for ± 10 %; of bounds, half "
            "their distance over their middle.",
            show_default="the scenario's, or 0.1",
        ),
    ] = None,
    max_calls: Annotated[
        int | None,
        typer.Option(
            min=1, help="Budget of simulator runs.", show_default="the scenario's, or 2000"
        ),
    ] = None,
    goal: Annotated[
        Goal | None, typer.Option(help="Target an estimate, or bounds if the risk order holds.")
    ] = None,
    aim: Annotated[
        str | None,
        typer.Option(
            help="Target a consequence, or the event by its name; the scenario's where not given."
        ),
    ] = None,
    batch_size: Annotated[
        int,
        typer.Option(
            min=1,
            help="Simulator runs asked for at a time: as many as run side by side. Batches above "
            "ten are grown into, and cost more runs.",
        ),
    ] = 10,
    replay_calls: Annotated[
        int,
        typer.Option(
            min=0,
            help="Most recorded events to simulate at the end, beside the budget, where the "
            "campaign leaves their outcome in doubt.",
        ),
    ] = 50,
    same_vehicle: Annotated[
        bool,
        typer.Option(
            "--same-vehicle",
            help="Keep stored outcomes although the simulator's source was edited: you vouch that "
            "they are the same.",
        ),
    ] = False,
    output: OutputFormat = Format.TEXT,
) -> None:
    """Estimate the crash probability of a scenario; resume what was interrupted."""
    del ctx
    from crashrate.runs import places, recorded, runner
    from crashrate.runs.scenario import Scenario

    places.require_run_place(out)
    what, model = Scenario.from_file(scenario), places.traffic_named(traffic)
    chosen = what.target.method if method is None else method.value
    events, without = recorded.events_for(traffic, model, chosen)
    n_stored = runner.n_stored(out)
    # what a simulator prints is not the answer
    with progress() as say, redirect_stdout(sys.stderr):
        estimate = runner.run(
            what,
            model,
            out,
            seed=seed,
            method=chosen,
            relative_half_width=relative_half_width,
            max_calls=max_calls,
            goal=goal and goal.value,
            aim=aim,
            batch_size=batch_size,
            same_vehicle=same_vehicle,
            events=events,
            without_events=without,
            replay_calls=replay_calls,
            on_progress=lambda campaign: say(standing(campaign, n_stored)),
            say=say,
        )
    _finish(out, estimate, output, n_stored)


@_command("crashrate status runs/cut_in", "crashrate status runs/cut_in --format json")
def status(ctx: typer.Context, directory: RunFolder, output: OutputFormat = Format.TEXT) -> None:
    """Show how a run stands, or what it found."""
    del ctx
    from crashrate.runs import runner

    print_result(runner.status(directory), output)


@_command("crashrate report runs/cut_in")
def report(ctx: typer.Context, directory: RunFolder) -> None:
    """Write the report of a run again, and print where it is."""
    del ctx
    typer.echo(_write_report(directory))


@_command("crashrate demo", "crashrate demo --seed 7 --out runs/demo")
def demo(
    ctx: typer.Context,
    seed: Seed = 0,
    out: Annotated[
        Path | None, typer.Option(help="Run folder.", show_default="runs/demo-SEED")
    ] = None,
) -> None:
    """Go all the way with synthetic events and the vehicle of the 2017 study.

    Needs no file and no network. The events are synthetic: drawn from the published mixture.
    """
    del ctx
    from crashrate.runs import demo as pieces
    from crashrate.runs import fitting, places, runner

    folder = Path("runs", f"demo-{seed}") if out is None else out
    places.require_run_place(folder)
    n_stored = runner.n_stored(folder)
    scenario, events = pieces.demo_scenario(), pieces.demo_events(seed)
    typer.echo(events.summary(), err=True)
    with progress() as say:
        say(f"fitting {pieces.N_COMPONENTS} components to the synthetic events")
        model = fitting.fit_traffic(
            scenario, events, (pieces.N_COMPONENTS,), seed=seed, synthetic=True
        )
        estimate = runner.run(
            scenario,
            model,
            folder,
            seed=seed,
            events=events,
            on_progress=lambda campaign: say(standing(campaign, n_stored)),
            say=say,
        )
    _finish(folder, estimate, Format.TEXT, n_stored)


# --- what commands share


def _finish(directory: Path, estimate: "Estimate", output: Format, n_stored: int) -> None:
    """Print the answer, write the report, leave with the exit code."""
    from crashrate.runs.result import read_result

    if n_stored:
        taken = min(n_stored, estimate.n_calls)
        new = runs(estimate.n_calls - taken, "new simulator run")
        typer.echo(f"{runs(taken, 'outcome')} taken from {directory}, {new}.", err=True)
    print_result(read_result(directory), output)  # first: a report that fails must not hide it
    typer.echo(f"{directory / 'result.json'}, {_write_report(directory)}", err=True)
    codes = {"TARGET_MET": 0, "ALL_FAILED": ERROR}
    raise typer.Exit(codes.get(estimate.stop_reason.name, TARGET_NOT_MET))


def _write_report(directory: Path) -> Path:
    from crashrate.reports.html import write_report
    from crashrate.runs.record import load_run
    from crashrate.runs.result import REPORT

    return write_report(load_run(directory), directory / REPORT)


def main() -> None:
    """Run the command line; the entry point of the ``crashrate`` command."""
    app(prog_name="crashrate")


if __name__ == "__main__":
    main()
