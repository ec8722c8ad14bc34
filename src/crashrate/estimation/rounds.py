"""Estimating rounds: each an unbiased estimate given the past, combined by predicted variance.

In one round the surrogate's sum over the pool, P0 = Σ w h, is corrected by simulated outcomes y of
n draws with probabilities pr: e = P0 + mean(w / pr · (y - h)) (a difference estimator, Särndal et
al. 1992 §6.3). Given the past, E[e] = p whatever h is, as long as pr > 0 where h can be wrong.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import stdtrit

from crashrate.estimation.selection import Drawn
from crashrate.estimation.traffic_range import TrafficRange
from crashrate.estimation.view import View, normalised
from crashrate.variables import FloatArray

# The ratios of scatter seen to scatter predicted are shrunk to 1 with the weight of this many
# rounds, and draws.
PRIOR_ROUNDS = 4
PRIOR_DRAWS = 20
MIN_ROUNDS = 4
# No round is surer of itself than this, relative to its prediction and absolutely: a surrogate that
# holds every draw to be safe predicts no variance at all.
CERTAIN, TINY = 1e-4, 1e-40
# A round whose prediction was below this share of the latest ones had not seen the crash set yet,
# and what it was sure of was wrong: it is left out.
MIN_PREDICTED, LATEST = 0.5, 3
MAX_PREDICTED = 2.0  # times the rounds' median: a larger prediction gains no weight


def _none() -> FloatArray:
    """Of a traffic model without members."""
    return np.empty(0)


@dataclass(frozen=True)
class Round:
    """One round's estimate.

    Parameters
    ----------
    n_runs : int
        Simulator runs that entered it.
    estimate : float
    lowest, highest : float
        The estimate with every failed simulation safe, and with every one a crash.
    predicted : float
        The surrogate's sum P0, before the outcomes were known.
    variance : float
        Of `estimate`, predicted likewise.
    n_draws : int
        Draws, repetitions included.
    squares : float
        Sum of the squared contributions of the draws: what `variance` predicted, as it came out.
    largest : float
        Largest contribution of a single run.
    members, member_variances : ndarray, shape (M,)
        Estimates under the traffic model's members, and their predicted variances.
    """

    n_runs: int
    estimate: float
    lowest: float
    highest: float
    predicted: float
    variance: float
    n_draws: int
    squares: float
    largest: float
    members: FloatArray = field(default_factory=_none)
    member_variances: FloatArray = field(default_factory=_none)


def measure(view: View, drawn: Drawn, outcomes: FloatArray) -> Round:
    """The round in which `drawn` had `outcomes` (n,): 1, 0, or NaN for a failed simulation."""
    rows, n = drawn.rows, len(drawn.rows)
    h = view.h[rows]
    factor = view.weights[rows] / drawn.probabilities[rows]
    failed = np.isnan(outcomes)
    moved = factor * (np.where(failed, h, outcomes) - h) / n
    down, up = (float((factor * np.where(failed, e - h, 0.0)).sum() / n) for e in (0.0, 1.0))
    estimate = view.probability + float(moved.sum())
    variance = predicted_variance(view, drawn.probabilities, n) + view.pool_variance
    variance = max(variance, (CERTAIN * view.probability) ** 2, TINY)
    largest = float(np.abs(moved).max())
    members = member_variances = _none()
    if (ratios := view.pool.ratios) is not None:
        members, member_variances = _under_members(view, drawn, moved, ratios)
    return Round(
        n_runs=len(np.unique(rows)),
        estimate=estimate,
        lowest=estimate + down,
        highest=estimate + up,
        predicted=view.probability,
        variance=variance,
        n_draws=n,
        squares=float(moved @ moved),
        largest=largest,
        members=members,
        member_variances=member_variances,
    )


def _under_members(
    view: View, drawn: Drawn, moved: FloatArray, ratios: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The same sums with each member's weights instead: estimates and variances (M,)."""
    part = view.weights * view.h
    estimates = part @ ratios + moved @ ratios[drawn.rows]
    spread = _variance_parts(view, drawn.probabilities) / len(drawn.rows)
    pool = np.maximum(part**2 @ ratios**2 - (part @ ratios) ** 2 / view.pool.n_drawn, 0.0)
    return estimates, np.maximum(spread @ ratios**2 + pool, TINY)


def predicted_variance(view: View, probabilities: FloatArray, n: int) -> float:
    """Variance of the correction if h is right: Σ w² h (1-h) / pr / n."""
    return float(_variance_parts(view, probabilities).sum() / n)


def _variance_parts(view: View, probabilities: FloatArray) -> FloatArray:
    """What each draw of the pool adds to the variance of one draw's correction."""
    return view.spread**2 / np.maximum(probabilities, 1e-300)


@dataclass(frozen=True)
class Combined:
    """The rounds together.

    Parameters
    ----------
    estimate, standard_error, half_width : float
        `half_width` at the confidence asked for; `estimate` within [0, 1].
    lower, upper : float
        The interval within [0, 1]; failed simulations counted either way.
    scatter : float
        Mean squared deviation of the rounds over their predicted variance: about 1.
    n_rounds : int
        Rounds that counted.
    largest_share : float
        Largest contribution of a single run over the estimate.
    members : TrafficRange or None
        The estimates under the traffic model's members.
    """

    estimate: float
    standard_error: float
    half_width: float
    lower: float
    upper: float
    scatter: float
    n_rounds: int
    largest_share: float
    members: TrafficRange | None = None


def combine(rounds: Sequence[Round], confidence: float) -> Combined:
    """Rounds weighted by the inverse square of their predicted coefficient of variation.

    (Not of the variance: a pool that happens to hold too little crash mass predicts a smaller
    variance and a lower estimate at once, and weights that prefer it bias the mean downwards. But a
    surrogate that for one round predicts many times the usual is wrong, and its round is noise: its
    variance counts as it is.)

    The interval is Student's, with the predicted variance inflated by what was seen: by the Birge
    ratio (Birge 1932) of the rounds' scatter to the predicted one, or by the ratio of the draws'
    squared contributions to the predicted ones, whichever is larger; both shrunk towards 1, and
    never below. Predictions alone are over-confident where the surrogate is (on the ACC+AEB plant
    by 1.3 in standard deviation), and the few rounds' own scatter alone under-covers.
    """
    rounds = not_refuted(rounds, float(np.median([r.predicted for r in rounds[-LATEST:]])))
    variance = np.array([r.variance for r in rounds])
    share = _shares(np.array([r.predicted for r in rounds]), variance)
    estimates = np.array([r.estimate for r in rounds])
    center = float(share @ estimates)
    squares = (estimates - center) ** 2 / variance
    freedom = PRIOR_ROUNDS + len(rounds) - 1
    birge = (PRIOR_ROUNDS + float(squares.sum())) / freedom
    predicted = float(share**2 @ variance)
    inflation = max(1.0, birge, _surprise(rounds, share, predicted))
    error = math.sqrt(inflation * predicted)
    half_width = float(stdtrit(freedom, 0.5 + confidence / 2)) * error
    lowest = float(share @ np.array([r.lowest for r in rounds]))
    highest = float(share @ np.array([r.highest for r in rounds]))
    largest = float((share * np.array([r.largest for r in rounds])).max())
    return Combined(
        # a corrected sum may leave [0, 1]; the nearest probability is nearer to the truth
        estimate=min(max(center, 0.0), 1.0),
        standard_error=error,
        half_width=half_width,
        lower=max(lowest - half_width, 0.0),
        upper=min(highest + half_width, 1.0),
        n_rounds=len(rounds),
        scatter=float(squares.mean()),
        largest_share=largest / center if center > 0 else 1.0,
        members=_members(rounds, share, inflation),
    )


def _members(rounds: Sequence[Round], share: FloatArray, inflation: float) -> TrafficRange | None:
    if not len(rounds[0].members):
        return None
    estimates = share @ np.array([r.members for r in rounds])
    variances = inflation * (share**2 @ np.array([r.member_variances for r in rounds]))
    return TrafficRange(tuple(estimates.tolist()), tuple(np.sqrt(variances).tolist()))


def not_refuted(rounds: Sequence[Round], predicted: float) -> list[Round]:
    """The rounds that had seen as much of the crash set as is now known, `predicted`, or half."""
    return [r for r in rounds if r.predicted >= MIN_PREDICTED * predicted]


def _shares(predicted: FloatArray, variance: FloatArray) -> FloatArray:
    usual = float(np.median(predicted))
    return normalised(np.minimum(predicted, MAX_PREDICTED * usual) ** 2 / variance)


def _surprise(rounds: Sequence[Round], share: FloatArray, predicted: float) -> float:
    """Squared contributions of the draws over the predicted ones, shrunk towards 1."""
    n = sum(r.n_draws for r in rounds)
    seen = float(share**2 @ np.array([r.squares for r in rounds]))
    return (PRIOR_DRAWS + n * seen / predicted) / (PRIOR_DRAWS + n)


def log_efficiency(combined: Combined, n_runs: int) -> float:
    """log E[Z²] / log E[Z] with the variance per simulator run of the combined estimate."""
    p = combined.estimate
    if not 0 < p < 1:
        return math.nan
    return math.log(combined.standard_error**2 * n_runs + p * p) / math.log(p)
