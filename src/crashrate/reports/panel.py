"""Panel: one numbered figure of the report, made of one or more plots and a caption."""

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Plot:
    """A plotly figure and what it shows, in words for those who cannot see it."""

    figure: Any
    description: str


@dataclass(frozen=True)
class Panel:
    """One figure of the report; without plots, a sentence, `caption`, that says why.

    Parameters
    ----------
    key : str
        Identifier in the page.
    title, caption : str
        Plain text.
    plots : tuple of Plot
    wide : bool
        Whether a plot takes the whole width of the page.
    """

    key: str
    title: str
    caption: str
    plots: tuple[Plot, ...] = ()
    wide: bool = False
