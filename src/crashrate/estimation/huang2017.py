"""The procedure of the 2017 paper, §VI, steps 1 to 7, and importance sampling with its result.

Z. Huang, H. Lam, D. Zhao, "An Accelerated Testing Approach for Automated Vehicles with Background
Traffic Described by Joint Distributions" (2017). What it says is done; where this has to differ,
a comment says so. In particular the density in the weights is that of the mixture drawn from.
"""

import math
from collections.abc import Generator
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from crashrate.errors import InvalidInputError
from crashrate.estimation.alarms import SHARE_LIMIT, UNDECIDED_LIMIT, Alarm, StopReason
from crashrate.estimation.exact_bounds import exact_bounds
from crashrate.estimation.exploration import INFLATION, inflated
from crashrate.estimation.labels import Labels
from crashrate.estimation.probing import probe
from crashrate.estimation.settling import Settled, settle
from crashrate.estimation.strategy import Problem, Query, Snapshot
from crashrate.estimation.tally import Tally
from crashrate.sampling.orthants import DominatingPoints, dominating_points
from crashrate.sampling.pool import draw_pool
from crashrate.sampling.proposals import (
    Proposal,
    learning_rho,
    mixed,
    recommended_rho,
    shifted,
)
from crashrate.variables import FloatArray

ESTIMATING = 10_000  # batches are numbered from here on while estimating
BOUNDING = 20_000
PROBING = 30_000
# the normal interval is not looked at before the estimate rests on as many equal crashes
MIN_N_EFF = 10.0
N_BOUNDS = 20_000


@dataclass(frozen=True, kw_only=True)
class Huang2017Settings:
    """What the paper leaves to its user.

    Parameters
    ----------
    n_per_iteration : int
        N of step 3.
    max_iterations : int
        First stopping rule of the iteration.
    max_elements : int
        Second stopping rule: the size of S_1 or S_0. The study's own run stopped at 56.
    max_corners : int
        Third: the number of corners, which is what steps 5 and 6 cost; it is near twice that of S_0
        in three risk coordinates and far more in five.
    learning_share : float
        Fourth: the share of the budget that the iteration may spend.
    defensive_share : float
        Of the traffic model in the proposal; its inverse bounds the weights.
    audit_share : float
        Simulated implied labels, for each simulated undecided draw, while estimating.
    n_per_block : int
        Draws between two looks at the interval.
    max_draws : int
        Draws, most of them without a simulator run, after which estimating gives up.
    """

    n_per_iteration: int = 300
    max_iterations: int = 20
    max_elements: int = 100
    max_corners: int = 2000
    learning_share: float = 0.25
    defensive_share: float = 0.1
    audit_share: float = 0.05
    n_per_block: int = 1000
    max_draws: int = 300_000

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name.endswith("_share") and not 0.0 < value < 1.0:
                raise InvalidInputError(f"{name}: expected a number in (0, 1), got {value}.")
            if not name.endswith("_share") and value < 1:
                raise InvalidInputError(f"{name}: expected at least 1, got {value}.")


@dataclass(frozen=True, kw_only=True)
class Huang2017Snapshot(Snapshot):
    """A snapshot with what the procedure has built, for the report.

    Parameters
    ----------
    iteration : int
        Iterations of steps 2 to 6 completed.
    rho : float
        ρ of `proposal`.
    inner, outer : DominatingPoints or None
        A_I and A_O; None before the first iteration.
    proposal : Proposal or None
    n_draws : int
        Draws of the proposal that the estimate rests on, with or without a simulator run.
    """

    iteration: int = 0
    rho: float = 0.0
    inner: DominatingPoints | None = field(default=None, repr=False)
    outer: DominatingPoints | None = field(default=None, repr=False)
    proposal: Proposal | None = field(default=None, repr=False)
    n_draws: int = 0


@dataclass(frozen=True)
class State:
    """Everything the next step starts from; the parameters are those of the snapshot."""

    labels: Labels
    proposal: Proposal
    iteration: int = 0
    rho: float = 0.0
    inner: DominatingPoints | None = None
    outer: DominatingPoints | None = None
    bounds: tuple[float, float] = (0.0, 1.0)
    tally: Tally = field(default_factory=Tally)


Steps = Generator[Query, FloatArray, State]
DEFAULT = Huang2017Settings()


def huang2017(
    problem: Problem, settings: Huang2017Settings = DEFAULT
) -> Generator[Query, FloatArray, Snapshot]:
    """Learn the sets, build the proposal, and sample from it until the target is met.

    Parameters
    ----------
    problem : Problem
        With a risk order: the procedure has no meaning without.
    settings : Huang2017Settings

    Returns
    -------
    generator of Query
        It receives outcomes (n,), 1, 0 or NaN, and returns the last `Huang2017Snapshot`.

    Raises
    ------
    InvalidInputError
        If the problem has no risk order.
    """
    if problem.order is None:
        raise InvalidInputError(
            "method 'huang2017': expected a risk order, got None; say in `risk` which way is "
            "riskier, or use the method 'sequential'."
        )
    return _procedure(problem, settings)


def _procedure(
    problem: Problem, settings: Huang2017Settings
) -> Generator[Query, FloatArray, Snapshot]:
    # step 1: A_I = A_O = {µ_i}, so that both proposals are the traffic model
    state = State(Labels.empty(problem), Proposal.of_traffic(problem.traffic))
    while not _learned(problem, settings, state):  # step 7
        state = yield from _iterate(problem, settings, state)
    state = yield from _probing(problem, settings, state)
    state = _proposing(problem, settings, state, final=True)
    stop = StopReason.RUNNING
    while stop is StopReason.RUNNING:
        state = yield from _sample_block(problem, settings, state)
        stop = _stop(problem, settings, state)
    state = replace(state, bounds=_bounds(problem, state))
    return _snapshot(problem, settings, state, stop)


# --- learning: steps 2 to 7


def _probing(problem: Problem, settings: Huang2017Settings, state: State) -> Steps:
    """Test the order where it decides; the paper takes it on trust."""
    wide = inflated(problem.traffic, (1.0, INFLATION))
    rng = problem.rng(PROBING)
    pool = draw_pool(wide, problem.traffic, state.labels.coordinates, N_BOUNDS, rng)
    snapshot = _snapshot(problem, settings, state)
    labels = yield from probe(problem, state.labels, pool, snapshot)
    return _proposing(problem, settings, replace(state, labels=labels), final=False)


def _learned(problem: Problem, settings: Huang2017Settings, state: State) -> bool:
    """Whether a stopping rule of the iteration applies."""
    learned = state.labels.learned
    if learned is None:  # `huang2017` has asked for an order
        return True
    return (
        state.iteration >= settings.max_iterations
        or max(len(learned.minimal_crashes), len(learned.maximal_safe)) >= settings.max_elements
        # differs: the paper's d^n0 orthants end it sooner
        or len(learned.corners) >= settings.max_corners
        # differs: the paper has no budget; here most of it is left for the estimate
        or state.labels.n >= _learning_budget(problem, settings)
    )


def _learning_budget(problem: Problem, settings: Huang2017Settings) -> int:
    return math.ceil(settings.learning_share * problem.max_calls)


def _iterate(problem: Problem, settings: Huang2017Settings, state: State) -> Steps:
    """Steps 2 to 6, once."""
    rng = problem.rng(state.iteration)
    x = state.proposal.sample(settings.n_per_iteration, rng)  # step 3
    snapshot = _snapshot(problem, settings, state)
    budget = _learning_budget(problem, settings)
    settled = yield from settle(problem, state.labels, x, budget, snapshot)  # step 4
    state = replace(state, labels=settled.labels, iteration=state.iteration + 1)
    state = _proposing(problem, settings, state, final=False)
    return replace(state, bounds=_bounds(problem, state))


def _proposing(
    problem: Problem, settings: Huang2017Settings, state: State, *, final: bool
) -> State:
    """Steps 5, 6 and 2: dominating points, f_I and f_O, and their mixture."""
    learned, order, traffic = state.labels.learned, problem.order, problem.traffic
    if learned is None or order is None:  # `huang2017` has asked for an order
        return state
    inner = dominating_points(traffic, order, learned.minimal_crashes, state.inner)  # step 5
    outer = dominating_points(traffic, order, learned.corners, state.outer)  # step 6
    rho = recommended_rho(inner, outer, traffic) if final else learning_rho(inner)
    proposal = mixed(
        rho,
        shifted(traffic, inner),
        shifted(traffic, outer),
        traffic,
        settings.defensive_share,
    )
    return replace(state, inner=inner, outer=outer, rho=rho, proposal=proposal)


# --- estimating: importance sampling


def _sample_block(problem: Problem, settings: Huang2017Settings, state: State) -> Steps:
    """Draw from the proposal, label the draws, audit some labels, and add up."""
    rng = problem.rng(ESTIMATING + state.tally.n // settings.n_per_block)
    x = state.proposal.sample(settings.n_per_block, rng)
    w = np.exp(problem.traffic.log_density(x) - state.proposal.log_density(x))
    snapshot = _snapshot(problem, settings, state)
    settled = yield from settle(problem, state.labels, x, problem.max_calls, snapshot)
    known = settled.known
    lost = settled.simulated & np.isnan(known)
    # where the budget ended inside the block, the draws from the first unknown one on are left out
    n = int(np.argmax(np.isnan(known) & ~lost)) if (np.isnan(known) & ~lost).any() else len(x)
    z = w * np.where(lost, 0.0, known)
    chance = _audit_chances(settled, w[:n], settings.audit_share)
    rows = np.flatnonzero(rng.random(n) < chance)
    labels, wrong = yield from _audit(problem, settled, x, rows, snapshot)
    corrections = np.zeros(n)
    corrections[rows] = w[rows] / chance[rows] * wrong
    tally = state.tally.add(z[:n] + corrections, w[:n][lost[:n]])
    return replace(state, labels=labels, tally=tally)


def _audit_chances(settled: Settled, w: FloatArray, share: float) -> FloatArray:
    """Probability (n,) with which each of the first n draws is audited, ∝ its weight w.

    Half of the audits look at implied crashes, half at draws implied to be safe.
    """
    n, chance = len(w), np.zeros(len(w))
    implied, n_audits = settled.implied[:n], max(1.0, share * float(settled.simulated.sum()))
    for label in (0.0, 1.0):
        rows = ~settled.simulated[:n] & (implied == label)
        if rows.any():
            chance[rows] = np.minimum(1.0, n_audits / 2 * w[rows] / w[rows].sum())
    return chance


def _audit(
    problem: Problem,
    settled: Settled,
    x: FloatArray,
    rows: npt.NDArray[np.intp],
    snapshot: Snapshot,
) -> Generator[Query, FloatArray, tuple[Labels, FloatArray]]:
    """Simulate the draws `rows`, whose labels are implied, and say by how much these are wrong.

    A draw audited with probability π adds w/π (outcome - implied label) to the sum, so that the
    mean is unbiased even where the order is wrong.
    """
    labels, wrong = settled.labels, np.zeros(len(rows))
    if not len(rows) or labels.n + len(rows) > problem.max_calls:  # a cut audit would be biased
        return labels, wrong
    y = yield Query(x[rows], snapshot)
    wrong = np.where(np.isnan(y), 0.0, y - settled.implied[rows])
    return labels.add(x[rows], y), wrong


def _stop(problem: Problem, settings: Huang2017Settings, state: State) -> StopReason:
    tally = state.tally
    low, high = tally.interval(problem.confidence, 1 / settings.defensive_share)
    narrow = (high - low) / 2 <= problem.target_at(state.labels.n) * tally.mean
    if tally.n_eff >= MIN_N_EFF and narrow:
        return StopReason.TARGET_MET
    if state.labels.n >= problem.max_calls:
        return StopReason.BUDGET_ENDED
    return StopReason.DRAWS_ENDED if tally.n >= settings.max_draws else StopReason.RUNNING


# --- what is known


def _bounds(problem: Problem, state: State) -> tuple[float, float]:
    """P(inner) and P(outer): exactly, or two standard errors to the safe side from draws."""
    learned, order, traffic = state.labels.learned, problem.order, problem.traffic
    if learned is None or order is None:
        return 0.0, 1.0
    exact = exact_bounds(problem, state.labels)
    if exact is not None:
        return exact
    x = state.proposal.sample(N_BOUNDS, problem.rng(BOUNDING + state.iteration))
    w = np.exp(traffic.log_density(x) - state.proposal.log_density(x))
    u = order(x)
    inner, outer = (
        Tally().add(w * inside) for inside in (learned.in_inner(u), learned.in_outer(u))
    )
    return (
        max(inner.mean - 2 * inner.standard_error, 0.0),
        min(outer.mean + 2 * outer.standard_error, 1.0),
    )


def _snapshot(
    problem: Problem,
    settings: Huang2017Settings,
    state: State,
    stop: StopReason = StopReason.RUNNING,
) -> Huang2017Snapshot:
    tally = state.tally
    return Huang2017Snapshot(
        probability=tally.estimate,
        interval=tally.interval(problem.confidence, 1 / settings.defensive_share),
        standard_error=tally.standard_error,
        bounds=state.bounds,
        n_eff=tally.n_eff,
        largest_weight_share=tally.largest_share,
        log_efficiency=tally.log_efficiency,
        alarms=_alarms(state, stop),
        learned=state.labels.learned,
        phase="estimate" if tally.n else f"learn {state.iteration}",
        stop_reason=stop,
        iteration=state.iteration,
        rho=state.rho,
        inner=state.inner,
        outer=state.outer,
        proposal=state.proposal,
        n_draws=tally.n,
    )


def _alarms(state: State, stop: StopReason) -> tuple[Alarm, ...]:
    tally = state.tally
    raised = {
        Alarm.NO_CRASH_FOUND: tally.n > 0 and not (state.labels.y == 1).any(),
        Alarm.WEIGHTS_CONCENTRATED: tally.total > 0.0 and tally.largest_share > SHARE_LIMIT,
        Alarm.ORDER_CONTRADICTED: state.labels.contradictions > 0,
        Alarm.UNDECIDED_MASS_LARGE: state.bounds[1] > UNDECIDED_LIMIT * tally.mean > 0.0,
        Alarm.TARGET_NOT_REACHED: stop is StopReason.DRAWS_ENDED,
    }
    return tuple(alarm for alarm, is_raised in raised.items() if is_raised)
