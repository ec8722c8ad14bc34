"""What a peer is: a name, settings, and a function of a limit state."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from peers.limit_state import Answer, LimitState


@dataclass(frozen=True)
class Peer:
    """A method of another tool.

    Parameters
    ----------
    name : str
    package : str
        The distribution it comes from, whose version is recorded.
    run : callable
        Takes a limit state, a seed and the settings.
    settings : mapping
        Recorded with every run; a run with other settings is another run.
    binary : bool
        Whether it is given the outcome (±1) in place of the margin.
    """

    name: str
    package: str
    run: Callable[[LimitState, int, Mapping[str, Any]], Answer]
    settings: Mapping[str, Any]
    binary: bool = False
