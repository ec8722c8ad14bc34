"""The easy call: a loop over a campaign's ask and tell."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from crashrate.errors import InvalidInputError
from crashrate.estimation.campaign import Campaign
from crashrate.estimation.estimate import Estimate
from crashrate.outcomes import Told
from crashrate.traffic.model import TrafficModel
from crashrate.variables import FloatArray


def estimate(
    simulate: Callable[[FloatArray], Told],
    traffic: TrafficModel,
    *,
    risk: Mapping[str, Any] | None = None,
    relative_half_width: float = 0.1,
    max_calls: int = 2000,
    confidence: float = 0.95,
    method: str = "sequential",
    goal: str = "probability",
    batch_size: int = 10,
    seed: int = 0,
    consequences: Sequence[str] = (),
    aim: str | None = None,
    on_batch: Callable[[Campaign], None] | None = None,
) -> Estimate:
    """The probability that `simulate` crashes in traffic.

    Parameters
    ----------
    simulate : callable
        Takes situations of shape (n, d) in the traffic model's variables and returns n outcomes:
        True or 1 a crash, False or 0 safe, NaN a failed simulation. With consequences as
        `Campaign.tell` takes them.
    traffic, risk, relative_half_width, max_calls, confidence, method, goal, batch_size, seed
        As of `Campaign`.
    consequences, aim
        As of `Campaign`.
    on_batch : callable, optional
        Called with the campaign after every batch, for progress.

    Returns
    -------
    Estimate

    Raises
    ------
    InvalidInputError
        If an argument is not as described, or `simulate` returns something else. What `simulate`
        itself raises is passed on, with a note of the situations it was given.
    """
    if not callable(simulate):
        swapped = "; the traffic model comes second" * isinstance(simulate, TrafficModel)
        raise InvalidInputError(
            "simulate: expected a function of situations (n, d), got "
            f"{type(simulate).__name__}{swapped}."
        )
    campaign = Campaign(
        traffic,
        risk=risk,
        seed=seed,
        relative_half_width=relative_half_width,
        max_calls=max_calls,
        confidence=confidence,
        method=method,
        goal=goal,
        batch_size=batch_size,
        consequences=consequences,
        aim=aim,
    )
    while not campaign.done:
        campaign.tell(_simulated(simulate, campaign))
        if on_batch is not None:
            on_batch(campaign)
    return campaign.estimate()


def _simulated(simulate: Callable[[FloatArray], Told], campaign: Campaign) -> Told:
    x = campaign.ask()
    try:
        return simulate(x)
    except Exception as error:
        error.add_note(
            f"crashrate: `simulate` raised this after {campaign.n_calls} outcomes, at situations "
            f"of shape {x.shape}, the first of them {x[0].tolist()}. Let it return NaN for a "
            "simulation that failed; `crashrate run` stores outcomes and goes on where it stopped."
        )
        raise
