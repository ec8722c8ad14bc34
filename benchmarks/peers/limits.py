"""What ends a run of the study: too many calls, or too many seconds."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class BudgetError(Exception):
    """The budget of calls or seconds is spent."""


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """Raise `BudgetError` after `seconds` of process time, wherever the run then is.

    By the profiling timer of POSIX systems; again every second, since tools have been seen to
    swallow what their function raises.
    """

    def end(_number: int, _frame: FrameType | None) -> None:
        raise BudgetError(f"more than {seconds:g} s")

    before = signal.signal(signal.SIGPROF, end)
    signal.setitimer(signal.ITIMER_PROF, seconds, 1.0)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
