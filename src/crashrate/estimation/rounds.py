"""Estimating rounds: each an unbiased estimate given the past, combined by predicted variance.

In one round the surrogate's sum over the pool, P0 = Σ w h, is corrected by simulated outcomes y of
n draws with probabilities pr: e = P0 + mean(w / pr · (y - h)) (a difference estimator, Särndal et
al. 1992 §6.3). Given the past, E[e] = p whatever h is, as long as pr > 0 where h can be wrong.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import stdtrit

from crashrate.estimation.hits import NONE, Hits, count
from crashrate.estimation.selection import Drawn, mean_squares
from crashrate.estimation.traffic_range import TrafficRange
from crashrate.estimation.view import View
from crashrate.estimation.within_unit import within_unit
from crashrate.variables import FloatArray

if TYPE_CHECKING:
    from crashrate.estimation.carried import Carried
    from crashrate.estimation.hindsight import Design

# What was seen is shrunk to what was predicted with the weight of this many rounds. The square of a
# draw's contribution tells half as much of the variance as that of a round's deviation: most draws
# are no surprise.
PRIOR_ROUNDS = 4
DRAW_WORTH = 0.5
DRAW_FREEDOM = 0.25  # degrees of freedom of what draws are worth: a few large ones make up the sum
MIN_ROUNDS = 3
WELL_WITHIN = 0.95  # of the target: what a last round that is cut to size aims at
# Rounds and draws that scatter less than predicted may narrow the interval so far, by variance.
MIN_INFLATION = 0.5
# No round is surer of itself than this, relative to its prediction and absolutely: a surrogate that
# holds every draw to be safe predicts no variance at all.
CERTAIN, TINY = 1e-4, 1e-40
# A round is left out whose pool holds less than this share of the crash mass known now …
MIN_PREDICTED = 0.5
# … or that foresaw less than this of it: what it was sure of and wrong about it will nearly never
# have drawn, so it is too low by that, in all but the rarest of campaigns. (Of the pool's mass less
# is asked: it is known from some of its rows, roughly; what was foreseen is exact.)
MIN_FORESEEN, LATEST = 0.75, 3
Values = FloatArray | float
MAX_PREDICTED = 2.0  # times the rounds' median: a larger prediction gains no weight


@dataclass(frozen=True, eq=False)
class Sums:
    """What a round says under each of the traffic model's M members, from the same draws.

    Parameters
    ----------
    estimates, predicted, variances, squares : ndarray, shape (M,)
        As `Round.estimate`, `.predicted`, `.variance` and `.squares`.
    """

    estimates: FloatArray
    predicted: FloatArray
    variances: FloatArray
    squares: FloatArray


@dataclass(frozen=True)
class Round:
    """One round's estimate.

    Parameters
    ----------
    n_runs : int
        Simulator runs that entered it.
    estimate : float
    lowest, highest : float
        The estimate with every failed simulation safe, and with every one a crash: those of the
        round, and all where the simulator fails.
    predicted : float
        The surrogate's sum P0, before the outcomes were known.
    known : float
        The same by what is known now.
    variance : float
        Of `estimate`, by what is known now: as predicted for the latest round.
    squares : float
        Half the squared differences of contributions that follow one another along h, with the
        pool's part of `variance`: what was predicted, as it came out.
    largest : float
        Largest contribution of a single run.
    members : Sums or None
        The same under the traffic model's members; None where it has none.
    consequences : tuple of Carried
        What the same draws say of the event's consequences.
    hits : Hits
    design : Design or None
        How its draws were chosen, to tell `known` and `variance` anew by later outcomes.
    then : Round or None
        The round as it was measured, where this is what is known of it now.
    """

    n_runs: int
    estimate: float
    lowest: float
    highest: float
    predicted: float
    known: float
    variance: float
    squares: float
    largest: float
    members: Sums | None = None
    consequences: tuple["Carried", ...] = ()
    hits: Hits = NONE
    design: "Design | None" = None
    then: "Round | None" = None


def measure(view: View, drawn: Drawn, outcomes: FloatArray) -> Round:
    """The round in which `drawn` had `outcomes` (k,): 1, 0, or NaN for a failed simulation."""
    found = corrected(view, view.h, view.spread, drawn, outcomes)
    drawing = predicted_variance(view, drawn.probabilities, drawn.n)
    variance = float(at_least(drawing + view.pool_variance, found.predicted))
    return replace(found, variance=variance, hits=count(view, drawn, outcomes))


def corrected(
    view: View, held: FloatArray, spread: FloatArray, drawn: Drawn, values: FloatArray
) -> Round:
    """The round in which `drawn` had `values`.

    Parameters
    ----------
    view : View
    held, spread : ndarray, shape (N,)
        Expectation of the value at each draw of the pool, and its weighted standard deviation.
    drawn : Drawn
    values : ndarray, shape (k,)
        In [0, 1]; NaN for a failed simulation.
    """
    rows, failed = drawn.rows, np.isnan(values)
    factor, expected = view.weights[rows] * drawn.factors, held[rows]
    moved = factor * (np.where(failed, expected, values) - expected)
    least, most = (float((factor * np.where(failed, e - expected, 0.0)).sum()) for e in (0.0, 1.0))
    failing = np.where(view.failing, view.weights, 0.0)
    predicted, of_pool = float(view.weights @ held), view.variance_of(held)
    drawing = float(spread**2 @ drawn.mean_squares)
    estimate = predicted + float(moved.sum())
    return Round(
        n_runs=len(rows),
        estimate=estimate,
        lowest=estimate + least - float(failing @ held),
        highest=estimate + most + float(failing @ (1 - held)),
        predicted=predicted,
        known=predicted,
        variance=float(at_least(drawing + of_pool, predicted)),
        squares=float(_squares(moved)) + of_pool,
        largest=float(np.abs(moved).max()),
        members=_under_members(view, held, spread, drawn, moved),
    )


def _squares(moved: FloatArray) -> FloatArray:
    """Variance of the sum of systematic draws' contributions (k, ...), as they lie along h.

    By successive differences (Wolter 2007, ch. 8), and the ends in full, for a surprising hit is
    the first of them: Σ (m_i - m_(i-1))² / 2 with nothing before and after. The same in expectation
    as squares where contributions are independent and of mean zero; but systematic draws leave out
    what changes evenly along h, as it does where a surrogate is too careful at a smooth edge.
    """
    none = np.zeros((1, *moved.shape[1:]))
    return np.asarray((np.diff(moved, axis=0, prepend=none, append=none) ** 2).sum(axis=0) / 2)


def at_least(variance: Values, predicted: Values) -> FloatArray:
    """`variance`, or that of the surest prediction allowed."""
    return np.maximum(variance, np.maximum((CERTAIN * np.asarray(predicted)) ** 2, TINY))


def _under_members(
    view: View, held: FloatArray, spread: FloatArray, drawn: Drawn, moved: FloatArray
) -> Sums | None:
    """The same sums with each member's weights instead."""
    if (ratios := view.pool.ratios) is None:
        return None
    part, drawn_ratios = view.weights * held, ratios[drawn.rows]
    predicted = part @ ratios
    drawing = (spread**2 * drawn.mean_squares) @ ratios**2
    pool = np.maximum((part**2) @ ratios**2 - predicted**2 / view.pool.n_drawn, 0.0)
    return Sums(
        estimates=predicted + moved @ drawn_ratios,
        predicted=predicted,
        variances=at_least(drawing + pool, predicted),
        squares=_squares(moved[:, None] * drawn_ratios) + pool,
    )


def predicted_variance(view: View, probabilities: FloatArray, n: int) -> float:
    """Variance of the correction if h is right: Σ w² h (1-h) / (n pr), and less of it than w² h.

    Beside the pool's: a row that is drawn for sure leaves the part of it that its outcome has.
    Without what is negligible.
    """
    return float(view.usual_spread**2 @ mean_squares(n * probabilities))


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
    inflation : float
        Of the predicted variance, by what was seen.
    freedom : float
        Degrees of freedom of the variance.
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
    inflation: float
    freedom: float
    members: TrafficRange | None = None


def combine(rounds: Sequence[Round], confidence: float, least: float = MIN_INFLATION) -> Combined:
    """Rounds weighted by the inverse square of their coefficient of variation, as known now.

    (Not of the variance: a pool that happens to hold too little crash mass predicts a smaller
    variance and a lower estimate at once, and weights that prefer it bias the mean downwards. But a
    surrogate that for one round predicts many times the usual is wrong, and its round is noise: its
    variance counts as it is.)

    The interval is Student's, with the predicted variance inflated by what was seen: the ratio of
    the draws' variance, as they came out, to the predicted one and the Birge ratio (Birge 1932) of
    the rounds' scatter to the predicted one, pooled by what each can tell, and shrunk towards 1.
    Predictions alone are over-confident where the surrogate is (on the ACC+AEB plant by 1.3 in
    standard deviation), and too careful at a smooth edge. Rounds count by their part in the
    variance of the whole: what an early surrogate got wrong says little of a late one. Scatter
    above the predicted counts in full: a pool that misses crashes is seen by no draw of its own.

    Parameters
    ----------
    rounds : sequence of Round
    confidence : float
    least : float
        Of the inflation.
    """
    return combine_all(counted(rounds), confidence, least)


def combine_all(rounds: Sequence[Round], confidence: float, least: float) -> Combined:
    """As `combine`, whatever the rounds foresaw."""
    estimates, known, variances, squares = (
        np.array([getattr(r, name) for r in rounds])
        for name in ("estimate", "known", "variance", "squares")
    )
    share = _shares(known, variances)
    n_runs = np.array([r.n_runs for r in rounds], dtype=float)
    found = _together(share, Sums(estimates, known, variances, squares), n_runs, least)
    center, error = float(found.center), math.sqrt(found.inflation * found.variance)
    half_width = float(stdtrit(found.freedom, 0.5 + confidence / 2)) * error
    lowest = float(share @ np.array([r.lowest for r in rounds]))
    highest = float(share @ np.array([r.highest for r in rounds]))
    largest = float((share * np.array([r.largest for r in rounds])).max())
    return Combined(
        **vars(within_unit(center, half_width, lowest, highest)),
        standard_error=error,
        half_width=half_width,
        n_rounds=len(rounds),
        scatter=float(found.scatter),
        largest_share=largest / center if center > 0 else 1.0,
        inflation=float(found.inflation),
        freedom=float(found.freedom),
        members=_members(rounds, n_runs, float(found.inflation)),
    )


def draws_to(
    target: float, c: Combined, per_draw: float, of_pool: float, confidence: float
) -> float:
    """Draws of one more round with which the interval would meet a relative half-width.

    Parameters
    ----------
    target : float
    c : Combined
        The rounds so far.
    per_draw, of_pool : float
        Predicted variance of a draw's correction, and that the pool adds.
    confidence : float
    """
    t = float(stdtrit(c.freedom + 1, 0.5 + confidence / 2))
    wanted = (WELL_WITHIN * target * c.estimate / t) ** 2
    if wanted <= 0:
        return math.inf
    missing = 1 / wanted - 1 / c.standard_error**2  # precisions add up
    room = 1 / (missing * c.inflation) - of_pool if missing > 0 else math.inf
    return per_draw / room if room > 0 else math.inf


@dataclass(frozen=True, eq=False)
class _Together:
    """R rounds together, under one law () or each of the members (M,)."""

    center: FloatArray
    variance: FloatArray
    scatter: FloatArray
    inflation: FloatArray
    freedom: FloatArray


def _together(share: FloatArray, sums: Sums, n_runs: FloatArray, least: float) -> _Together:
    """Rounds of `n_runs` (R,) combined by their shares (R, ...)."""
    center = (share * sums.estimates).sum(axis=0)
    squares = (sums.estimates - center) ** 2 / sums.variances
    variance = (share**2 * sums.variances).sum(axis=0)
    part = share**2 * sums.variances / variance
    freedom = PRIOR_ROUNDS + 1 / (part**2).sum(axis=0) - 1
    scatter = (PRIOR_ROUNDS + (part * squares).sum(axis=0) / (part**2).sum(axis=0)) / freedom
    worth = DRAW_WORTH / (part.T**2 / n_runs).sum(axis=-1)
    surprise = (share**2 * sums.squares).sum(axis=0) / variance
    pooled = (freedom * scatter + worth * surprise) / (freedom + worth)
    # draws say nothing of scatter that none of them sees; few rounds hardly show that it is small
    unseen = scatter > np.maximum(pooled, 1.0)
    inflation = np.maximum(least, np.where(unseen, scatter, pooled))
    known = np.where(unseen, freedom, freedom + DRAW_FREEDOM * worth)
    return _Together(center, variance, squares.mean(axis=0), inflation, known)


def _members(rounds: Sequence[Round], n_runs: FloatArray, least: float) -> TrafficRange | None:
    """Each member by its own shares: a round directed at it says little about the others.

    A round that had not seen the member's crashes is left out for it, as `not_refuted` does for
    all. The inflation is the member's own, and never less than that of the average, `least`: what
    is wrong with the surrogate there is seldom right elsewhere.
    """
    found = [r.members for r in rounds if r.members is not None]
    if not found:
        return None
    names = ("estimates", "predicted", "variances", "squares")
    sums = Sums(*(np.array([getattr(s, name) for s in found]) for name in names))
    known = MIN_PREDICTED * np.median(sums.predicted[-LATEST:], axis=0)
    predicted = np.where(sums.predicted >= known, sums.predicted, np.nan)
    share = _shares(predicted, sums.variances)
    got = _together(share, sums, n_runs, least)
    error = np.sqrt(got.inflation * got.variance)
    return TrafficRange(tuple(got.center.tolist()), tuple(error.tolist()))


def counted(rounds: Sequence[Round]) -> Sequence[Round]:
    """The rounds that count, by the latest ones; all where none foresaw what is known now."""
    known = float(np.median([r.known for r in rounds[-LATEST:]]))
    foreseen = [r for r in rounds if r.predicted >= MIN_FORESEEN * known]
    return not_refuted(foreseen, known) or rounds


def not_refuted(rounds: Sequence[Round], probability: float) -> list[Round]:
    """The rounds that saw as much crash mass as is now known, `probability`, or half of it."""
    return [r for r in rounds if min(r.known, r.predicted) >= MIN_PREDICTED * probability]


def _shares(predicted: FloatArray, variance: FloatArray) -> FloatArray:
    """Shares (R, ...) of rounds, one in sum over them; none where nothing is predicted (NaN)."""
    usual = np.nanmedian(predicted, axis=0)
    weights = np.nan_to_num(np.minimum(predicted, MAX_PREDICTED * usual) ** 2 / variance)
    total = weights.sum(axis=0)
    return np.asarray(np.where(total > 0, weights / np.maximum(total, TINY), 1 / len(predicted)))


def log_efficiency(combined: Combined, n_runs: int) -> float:
    """log E[Z²] / log E[Z] with the variance per simulator run of the combined estimate."""
    p = combined.estimate
    if not 0 < p < 1:
        return math.nan
    return math.log(combined.standard_error**2 * n_runs + p * p) / math.log(p)
