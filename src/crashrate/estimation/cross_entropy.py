"""The method "cross-entropy": Gaussian mixtures fitted to weighted crashes, and sampled from.

The proposal that is nearest to traffic *given a crash*, in Kullback–Leibler divergence, is the
maximum-likelihood fit to crashes weighted by f/q. Adapting draws from a proposal, simulates, and
fits the next one; estimating draws anew from the last proposal, which stays fixed, so that the mean
of f/q · 1{crash} is unbiased whatever the fit is worth.

What differs from the literature, and why:

- Rubinstein (1997) and Kurtz & Song (2013) lower a level of the simulator's margin until it means a
  crash. Here outcomes are binary and there are no levels: adapting starts from inflated traffic, in
  which crashes are not rare, or around the crash that exploration found, and raises the exponent of
  the weights instead, from w^α with as large an α as leaves enough equal ones, up to w itself.
- They fit to the last draws alone. Here runs are dear: all draws so far are weighted by the mixture
  of all proposals so far (Veach & Guibas 1995), and where their crashes are fewer than a fit needs,
  the proposal is a kernel of traffic's own width around each.
- They fit until the level is reached. Here a proposal is good where its own draws, to which it was
  not fitted, say so twice in a row. Those draws are not used again: to go on only after good ones
  and to count them would favour draws without a large weight.
- Geyer et al. (2019) choose the number of components by clustering; here it grows with the
  effective number of crashes. Fits are widened (see `crash_density`), for a fit to few crashes is
  narrow, and stand beside shares of traffic, which bounds the weights (Hesterberg 1995), of
  inflated traffic, and of a broad fit: a crash region that the weights leave out is drawn now and
  then, and widens the interval.
- The interval is no plain normal one (see `weighted_draws`), and is not looked at until twice the
  draws that the last proposal says are needed: to stop as soon as it is narrow would stop early
  where no large weight has come yet, five per cent too low.

The risk order is used to find the first crash, if at all. Exploration's runs enter no estimate.

References
----------
R. Y. Rubinstein, "Optimization of computer simulation models with rare events", European Journal of
Operational Research 99 (1997). N. Kurtz, J. Song, "Cross-entropy-based adaptive importance sampling
using Gaussian mixture", Structural Safety 42 (2013). S. Geyer, I. Papaioannou, D. Straub, "Cross
entropy-based importance sampling using Gaussian densities revisited", Structural Safety 76 (2019).
"""

import math
from collections.abc import Generator
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp, ndtri

from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.estimation.crash_density import broad, n_eff, sharp
from crashrate.estimation.crude import crude
from crashrate.estimation.exploration import explore
from crashrate.estimation.strategy import Problem, Query, Snapshot
from crashrate.estimation.weighted_draws import WeightedDraws
from crashrate.sampling.gaussians import Gaussians
from crashrate.sampling.pool import Blend
from crashrate.variables import FloatArray

ESTIMATING = 10_000  # the random streams of the estimate, beside those of the iterations
# of the proposal: traffic, inflated traffic, the broad and the sharp fit
TRAFFIC_SHARE = 0.1
SHARES = (TRAFFIC_SHARE, 0.2, 0.2, 0.5)
N_FIRST, N_PER_ITERATION = 600, 200  # draws inside the box
MIN_ITERATIONS, MAX_ITERATIONS = 4, 10
ENOUGH = 20  # crashes to fit to, and to judge a proposal by
GOOD = 0.3  # of the crashes' number: as many equal ones do the weights of a good proposal leave
GOOD_IN_A_ROW = 2
N_PER_BLOCK = 100  # draws of the last proposal
MIN_DRAWS, MARGIN = 500, 2.0  # before the first look: at least, and times those that it may take
GROWTH = 1.5  # of the number of draws from one look to the next


@dataclass(frozen=True)
class Adapted:
    """What adapting has drawn so far.

    Parameters
    ----------
    wide : Gaussians
        The inflated traffic model.
    first : ndarray, shape (j, d)
        Crashes that exploration found: no draws of a known density.
    n_calls : int
        Simulator runs, those of exploration included.
    x : ndarray, shape (k, d)
        The draws that crashed.
    drawn : tuple of (Blend, int)
        The proposals, and how many draws came from each, those outside the box included.
    n_good : int
        Good proposals in a row, up to the last one.
    n_eff_per_draw : float
        Equally weighted crashes for each draw of the last proposal.
    """

    wide: Gaussians
    first: FloatArray
    n_calls: int
    x: FloatArray
    drawn: tuple[tuple[Blend, int], ...] = ()
    n_good: int = 0
    n_eff_per_draw: float = 0.0

    @property
    def good(self) -> bool:
        """Whether the last proposals may be believed to be good."""
        return len(self.drawn) >= MIN_ITERATIONS and self.n_good >= GOOD_IN_A_ROW

    def log_weights(self, problem: Problem) -> FloatArray:
        """log f/q of the draws that crashed, shape (k,): q is the mixture of all draws so far."""
        n = np.array([count for _, count in self.drawn], dtype=np.float64)
        logs = np.stack([density.log_density(self.x) for density, _ in self.drawn])
        log_q = logsumexp(np.log(n / n.sum())[:, None] + logs, axis=0)
        return np.asarray(problem.traffic.log_density(self.x) - log_q)


def cross_entropy(problem: Problem) -> Generator[Query, FloatArray, Snapshot]:
    """Adapt a proposal, then estimate with it; see the module."""
    explored = yield from explore(problem, 2 + problem.traffic.n_variables)
    labels = explored.labels
    if not explored.found:
        found = yield from crude(problem, labels)
        if isinstance(found, Snapshot):
            return found
        labels = found
    adapted = Adapted(explored.wide, labels.crashes, labels.n, labels.crashes[:0])
    while not adapted.good and len(adapted.drawn) < MAX_ITERATIONS:
        if adapted.n_calls >= problem.max_calls:
            return replace(_adapting(adapted), stop_reason=StopReason.BUDGET_ENDED)
        adapted = yield from _iterate(problem, adapted)
    proposal = _proposal(problem, adapted, problem.rng(ESTIMATING))
    return (yield from _estimate(problem, adapted, proposal))


# --- adapting


def _iterate(problem: Problem, state: Adapted) -> Generator[Query, FloatArray, Adapted]:
    """Fit a proposal, and simulate draws from it inside the box."""
    rng = problem.rng(1 + len(state.drawn))
    proposal = _proposal(problem, state, rng)
    n = N_PER_ITERATION if state.drawn else N_FIRST
    # as many draws as hold enough inside the box: all of traffic's own are
    x = rng.permutation(proposal.sample(math.ceil(n / TRAFFIC_SHARE) + 1, rng))
    inside = np.flatnonzero(problem.traffic.contains(x))[:n]
    y = yield from _simulate(problem, state, x[inside])
    crashed = x[inside[: len(y)][y == 1]]
    log_w = problem.traffic.log_density(crashed) - proposal.log_density(crashed)
    is_good = len(crashed) >= ENOUGH and n_eff(log_w) >= GOOD * len(crashed)
    n_drawn = int(inside[-1]) + 1
    return replace(
        state,
        n_calls=state.n_calls + len(y),
        x=np.concatenate([state.x, crashed]),
        drawn=(*state.drawn, (proposal, n_drawn)),
        n_good=state.n_good + 1 if is_good else 0,
        n_eff_per_draw=n_eff(log_w) / n_drawn,
    )


def _simulate(
    problem: Problem, state: Adapted, x: FloatArray
) -> Generator[Query, FloatArray, FloatArray]:
    """Outcomes of `x` (n, d), or of as many as the budget allows."""
    x = x[: problem.max_calls - state.n_calls]
    y = np.empty(0)
    for start in range(0, len(x), problem.batch_size):
        outcomes = yield Query(x[start : start + problem.batch_size], _adapting(state))
        y = np.concatenate([y, outcomes])
    return y


def _proposal(problem: Problem, state: Adapted, rng: np.random.Generator) -> Blend:
    """Inflated traffic at first; then fits to the crashes so far, with shares of both traffics."""
    traffic = problem.traffic
    if not state.drawn:
        return Blend((TRAFFIC_SHARE, 1 - TRAFFIC_SHARE), (traffic, state.wide))
    if len(state.x) >= ENOUGH:
        x, log_w = state.x, state.log_weights(problem)
    else:  # the likeliest of them, whatever they were drawn from
        x = np.concatenate([state.first, state.x])
        log_w = traffic.log_density(x)
    fits = [fit(traffic, x, log_w, rng) for fit in (broad, sharp)]
    return Blend(SHARES, (traffic, state.wide, *fits))


def _adapting(state: Adapted) -> Snapshot:
    return Snapshot(alarms=(Alarm.NO_ORDER,), phase=f"adapt {len(state.drawn) + 1}")


# --- estimating


def _estimate(
    problem: Problem, adapted: Adapted, proposal: Blend
) -> Generator[Query, FloatArray, Snapshot]:
    """Draw from the proposal until the interval is narrow at a look, or the budget ends."""
    draws, n_calls, k = WeightedDraws(TRAFFIC_SHARE), adapted.n_calls, 0
    while n_calls < problem.max_calls:
        draws, n_calls = yield from _add_block(problem, proposal, draws, n_calls, k)
        k += 1
        target = problem.target_at(n_calls)
        first = _first_look(adapted, target, problem.confidence)
        if _is_look(draws.tally.n, first) and _narrow(draws, target, problem.confidence):
            return _snapshot(problem, draws, StopReason.TARGET_MET)
    return _snapshot(problem, draws, StopReason.BUDGET_ENDED)


def _add_block(
    problem: Problem, proposal: Blend, draws: WeightedDraws, n_calls: int, k: int
) -> Generator[Query, FloatArray, tuple[WeightedDraws, int]]:
    """Draw the k-th block, and simulate what is inside the box."""
    # blocks depend on no target: another one goes on with the same draws
    rng = problem.rng(ESTIMATING + 1 + k)
    # `Blend` shares the draws out by count: in random order, for the budget may end between them
    x = rng.permutation(proposal.sample(N_PER_BLOCK, rng))
    rows = np.flatnonzero(problem.traffic.contains(x))
    w = np.exp(problem.traffic.log_density(x[rows]) - proposal.log_density(x[rows]))
    came = rng.random(len(rows)) < TRAFFIC_SHARE * w  # from traffic's share, given where they lie
    # a draw outside the box adds zero at no cost: it goes with the run before it
    ends, begun = np.append(rows[1:], len(x)), 0
    for start in range(0, len(rows), problem.batch_size):
        part = slice(start, start + min(problem.batch_size, problem.max_calls - n_calls))
        y = yield Query(x[rows[part]], _snapshot(problem, draws))
        ended = int(ends[part][-1])
        draws = draws.add(w[part], y, came[part], ended - begun)
        n_calls, begun = n_calls + len(y), ended
        if n_calls >= problem.max_calls:
            break
    return draws, n_calls


def _first_look(adapted: Adapted, target: float, confidence: float) -> float:
    """Number of draws at which the interval is looked at for the first time."""
    wanted = MARGIN * (float(ndtri(0.5 + confidence / 2)) / target) ** 2
    return max(MIN_DRAWS, wanted / max(adapted.n_eff_per_draw, 1e-6))


def _is_look(n: int, first: float) -> bool:
    """Whether one of the looks at first · GROWTH^j draws lies in the block that ends at n."""
    if n < first:
        return False
    last = first * GROWTH ** math.floor(math.log(n / first) / math.log(GROWTH))
    return n - N_PER_BLOCK < last


def _narrow(draws: WeightedDraws, target: float, confidence: float) -> bool:
    low, high = draws.interval(confidence)
    return draws.trusted and (high - low) / 2 <= target * draws.tally.mean


def _snapshot(
    problem: Problem, draws: WeightedDraws, stop: StopReason = StopReason.RUNNING
) -> Snapshot:
    tally = draws.tally
    return Snapshot(
        probability=tally.estimate,
        interval=draws.interval(problem.confidence),
        standard_error=tally.standard_error,
        n_eff=tally.n_eff,
        largest_weight_share=tally.largest_share,
        log_efficiency=tally.log_efficiency,
        alarms=(Alarm.NO_ORDER, *draws.alarms(problem.confidence)),
        phase="estimate",
        stop_reason=stop,
    )
