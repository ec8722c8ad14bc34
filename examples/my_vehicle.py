"""A vehicle of one's own: a function from situations to outcomes.

This one brakes at once, as hard as it can, after a reaction time, and crashes if that is not
enough. Yours may call any simulator; return NaN for a run that failed.
"""

import numpy as np

REACTION_TIME = 0.6  # s
DECELERATION = 7.0  # m/s²


def simulate(x: np.ndarray) -> np.ndarray:
    """Crash or not, one outcome a row of x: v_lead [m/s], inv_range [1/m], inv_ttc [1/s]."""
    _, inv_range, inv_ttc = x.T
    gap, closing_speed = 1 / inv_range, inv_ttc / inv_range
    return gap < closing_speed * REACTION_TIME + closing_speed**2 / (2 * DECELERATION)
