"""What can be wrong with an estimate, and why a campaign stopped: values that are messages."""

from enum import StrEnum

# The limits that WEIGHTS_CONCENTRATED and UNDECIDED_MASS_LARGE speak of.
SHARE_LIMIT = 0.25
UNDECIDED_LIMIT = 50.0


class Alarm(StrEnum):
    """A named doubt about an estimate; the value is what a person reads."""

    NO_CRASH_FOUND = (
        "no crash was found: the interval's upper end comes from random encounters alone, and is "
        "far above any rare probability; check that the simulator returns true for a crash, and "
        "takes the columns in their order and units"
    )
    TOO_FEW_CRASHES = (
        "the estimate rests on fewer than ten simulated crashes, or on fewer than three among the "
        "runs drawn to estimate it: the interval's normal approximation is not to be trusted"
    )
    UNSETTLED = (
        "the estimate has not settled: it moves by a multiple from round to round, or its interval "
        "is wider than half of it to either side; the upper end is what the runs could have missed"
    )
    OUTCOMES_UNFORESEEN = (
        "the last look met an outcome that was not expected, a crash far from all others or safety "
        "where crashes were thought sure: there may be more of them, which are in neither the "
        "estimate nor its interval"
    )
    WEIGHTS_CONCENTRATED = (
        "one simulator run moves the estimate by more than a quarter: the next run may move it "
        "as much"
    )
    WEIGHTS_HEAVY_TAILED = (
        "the weights of the crashes fall off so slowly that runs yet to come may outweigh all so "
        "far: the interval's upper end comes from the draws of ordinary traffic alone"
    )
    SCATTER_BEYOND_PREDICTION = (
        "the rounds scatter more than predicted: the interval was widened by the scatter seen"
    )
    ORDER_CONTRADICTED = (
        "some outcomes contradict the declared risk order: an estimate and its interval allow for "
        "ripples at the edge of the crash set as deep as those seen, and for no deeper ones; the "
        "bounds P(inner), P(outer) hold only where the order does"
    )
    ORDER_DROPPED = (
        "the declared risk order was dropped: its most dangerous situations were safe, or too many "
        "outcomes contradict it; the estimate trusts no outcome that it implies"
    )
    LEFT_OUT_MATTERS = (
        "the declared risk order was given up, and a variable that no risk coordinate depends on, "
        "or a direction in which none of them changes, may be why: declare it too, if danger grows "
        "along it, or no order"
    )
    LEFT_OUT_UNTESTED = (
        "the risk order does not see some variable, or some direction, and that was not tested, "
        "for the budget ended before, or no outcome implies safety far out along it: crashes that "
        "depend on it are in neither the estimate nor its interval"
    )
    NEARLY_ALL_CRASH = (
        "nearly every ordinary encounter would crash: check that the simulator returns true for a "
        "crash, and takes the columns in their order and units"
    )
    TRAFFIC_UNDETERMINED = (
        "the events do not determine the probability, or what is aimed at: traffic models that fit "
        "them about as well, or a model fitted to other events of the same traffic, would give "
        "another by more than a factor of two"
    )
    MEMBERS_UNDETERMINED = (
        "some of the traffic models put their crashes where the simulator runs have seen too "
        "little: their part of the range is rough"
    )
    TAIL_MISFIT = (
        "the events, made more severe, crash more often or less often than the traffic model "
        "expects: its tail, and any probability from it, is in doubt"
    )
    EXTREMES_DISAGREE = (
        "extreme-value theory on the events' margins to a crash excludes the probability: the "
        "traffic model's tail is in doubt"
    )
    NEAR_MISSES_DISAGREE = (
        "near misses are rarer or more frequent in the traffic model than in the events, at two "
        "levels of one quantity or more: its tail, and any probability from it, is in doubt"
    )
    EVENTS_DROPPED = (
        "more than a tenth of the recorded encounters were dropped as invalid: the traffic model "
        "describes the others alone; look at why, and at the units of the columns"
    )
    REPLAY_DISAGREES = (
        "replaying the events excludes the probability: the traffic model does not describe them"
    )
    FEW_EVENTS_DECIDE = (
        "five events carry half or more of what the events leave open: look at them before the "
        "number is used"
    )
    NO_ORDER = (
        "no risk order is in use: crash regions that no run came near are taken as safe, and "
        "the bounds say nothing"
    )
    CONSEQUENCE_UNDETERMINED = (
        "too few simulator runs had one of the consequences, or one of them moves it by more than "
        "a quarter, or its interval is wider than half of it to either side: aim at it to know "
        "more, or where it is aimed at give more runs"
    )
    ENCOUNTERS_DISAGREE = (
        "random encounters crash far more often than the estimate allows: the interval was widened "
        "to what they show"
    )
    UNDECIDED_MASS_LARGE = (
        "situations that no outcome decides carry more than fifty times the estimate: the bounds "
        "are far apart, and a crash region among them that no run came near is left out of the "
        "estimate and its interval"
    )
    SIMULATIONS_FAILED = (
        "some simulations failed: the interval holds with each of those it rests on counted as a "
        "crash and as safe, and likewise with regions in which all runs failed; it narrows where "
        "fewer of them fail"
    )
    ALL_FAILED = (
        "every simulation failed: run the simulator on one of the situations that were asked for "
        "and look at what it returns; NaN says that it failed. A run folder keeps these outcomes: "
        "begin in another one once the simulator is mended"
    )
    TARGET_NOT_REACHED = "the budget ended before the target was reached"
    TARGET_UNCHECKED = (
        "the interval is as narrow as was asked, but the budget ended before what it rests on was "
        "checked: a few more runs would do that"
    )


class StopReason(StrEnum):
    """Why a campaign asks for no more simulator runs, or that it still does."""

    RUNNING = "not finished"
    TARGET_MET = "the target was met"
    BUDGET_ENDED = "the budget of simulator runs ended"
    ALL_FAILED = "every simulation failed"
    ORDER_DROPPED = "the risk order was dropped, and without one there are no bounds"
    ALL_DECIDED = "the outcomes decide every situation that was drawn"
    DRAWS_ENDED = "the budget of draws from the proposal ended"
