"""What a command leaves with: an exit code, and an error on one line."""

from collections.abc import Iterator
from contextlib import contextmanager

import typer

from crashrate.errors import CrashrateError

ERROR, TARGET_NOT_MET, INTERRUPTED = 1, 3, 130
INTERRUPTED_WORDS = "Interrupted. The same command goes on where a run stopped; a fit begins again."


@contextmanager
def plain_errors(*, debug: bool) -> Iterator[None]:
    """Errors on one line of standard error, never a traceback unless for debugging."""
    try:
        yield
    except (typer.Exit, typer.BadParameter, BrokenPipeError):
        raise
    except KeyboardInterrupt:
        typer.echo(INTERRUPTED_WORDS, err=True)
        raise typer.Exit(INTERRUPTED) from None
    except Exception as error:
        if debug:
            raise
        typer.echo(f"Error: {_message(error)}", err=True)
        raise typer.Exit(ERROR) from None


def _message(error: Exception) -> str:
    if isinstance(error, CrashrateError):
        return str(error)
    if isinstance(error, OSError):
        return f"{error.filename}: {error.strerror}." if error.filename else str(error)
    kind = type(error).__name__
    return f"unexpected {kind}: {error}. Please report it, with what crashrate --debug … shows."
