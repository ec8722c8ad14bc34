"""Progress on standard error, for whoever waits."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import typer

SECONDS_BETWEEN_LINES = 5.0

Say = Callable[[str], None]


@contextmanager
def progress() -> Iterator[Say]:
    """A line that changes on a terminal, a line every few seconds elsewhere."""
    from rich.console import Console

    console = Console(stderr=True, highlight=False)
    if console.is_terminal:
        with console.status("starting") as shown:
            yield shown.update
    else:
        with now_and_then() as say:
            yield say


@contextmanager
def now_and_then() -> Iterator[Say]:
    """The first text at once, then the latest one every few seconds, also while none comes."""
    texts: list[str] = []
    stop, start = threading.Event(), time.monotonic()

    def say(text: str) -> None:
        if not texts:
            typer.echo(text, err=True)
        texts[:] = [text]

    def repeat() -> None:
        while not stop.wait(SECONDS_BETWEEN_LINES):
            if texts:
                typer.echo(f"{texts[0]} ({time.monotonic() - start:.0f} s)", err=True)

    thread = threading.Thread(target=repeat, daemon=True)
    thread.start()
    try:
        yield say
    finally:
        stop.set()
        thread.join()
