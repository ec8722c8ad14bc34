"""Rounds directed at members of the traffic model that the runs do not determine yet.

The campaign estimates for the members' average, and a member whose crashes are few there gets few
draws: its part of the range is rough although its own crash probability may be as plain to find.
Once the average's target is met, a few rounds are drawn for such members. They stay unbiased for
the average and for every member: only the draws' known probabilities change.
"""

import numpy as np

from crashrate.estimation.traffic_range import MIN_N_EFF, TrafficRange
from crashrate.estimation.view import View

# Each costs a batch of runs. Of ten campaigns on fits to recorded lane changes (target ± 30 %),
# seven left members unclear; one or two rounds determined them in six of these, six in the other.
MAX_ROUNDS = 6
LEARNING_ROUNDS = 3  # the first ones, where the surrogate is unsure of the members' crashes
# A member that cannot be above a hundredth of the median is left as it is: the range takes it by
# its upper value, which already says "far below the others", and a sharper number would not change
# what a reader makes of the range. Its crashes may be too far from any run to be worth the search.
NEGLIGIBLE = 0.01

Members = tuple[int, ...]


def unclear(found: TrafficRange | None) -> Members:
    """The members that more runs should look at."""
    if found is None:
        return ()
    least = NEGLIGIBLE * float(np.median(np.maximum(found.probabilities, 0.0)))
    members = np.flatnonzero((found.n_eff < MIN_N_EFF) & (found.upper >= least))
    return tuple(members.tolist())


def towards(view: View, members: Members) -> View:
    """`view` as traffic sees it in which each of `members` has an equal share of the crashes."""
    if view.pool.ratios is None or not members:
        return view
    ratios = view.pool.ratios[:, members]
    mass = (view.weights * view.h) @ ratios
    return view.under(ratios @ (1 / np.maximum(mass, np.finfo(float).tiny)))
