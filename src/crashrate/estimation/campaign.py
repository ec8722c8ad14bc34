"""The campaign: ask for situations, tell their outcomes, estimate. The one class with state."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from crashrate.crash_set.order import RiskOrder
from crashrate.errors import CallOrderError, InvalidInputError
from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.estimation.estimate import Estimate, HistoryPoint
from crashrate.estimation.methods import TELL_MEMBERS, declared, method_for
from crashrate.estimation.strategy import Problem, Query, Snapshot, unknown
from crashrate.estimation.suspect import Suspect, suspect
from crashrate.outcomes import Told, told_table
from crashrate.traffic.model import TrafficModel
from crashrate.variables import FloatArray, as_rows

MIN_CRASHES = 10
NEARLY_ALL = 0.9  # a probability above it is rather an outcome turned round
MAX_FAILURES = 20  # a simulator that has failed as often and never run will not run


class Campaign:
    """Ask for situations, tell their outcomes, until the estimate is tight enough.

    Parameters
    ----------
    traffic : TrafficModel
        How often each situation occurs. One with members stands for their average, and the
        estimate says what each of them makes of the same runs; with any method but "sequential"
        it stands for itself, and a warning says that its members are left out.
    risk : mapping or None
        Which way is riskier: a variable's name, or a derived coordinate given as
        ``name: (function, direction)``, to "increasing" or "decreasing". None claims nothing.
    seed : int
        The campaign is a function of the configuration, the seed and the outcomes.
    relative_half_width : float
        Target: half the interval over the estimate, up to 1. By the method "sequential" a wider
        target than 0.5 takes as many runs as 0.5: a wider interval is not believed to be one.
    max_calls : int
        Budget of simulator runs.
    confidence : float
        Level of the interval.
    method : {"sequential", "huang2017", "crude", "cross-entropy"}
        The campaign of docs/method.md; for comparison, the procedure of the 2017 paper, random
        encounters, or importance sampling by cross-entropy.
    goal : {"probability", "bounds"}
        "probability" estimates it with an interval. "bounds" spends the runs on the bracket
        P(inner) ≤ p ≤ P(outer) alone, needs a risk order, and gives bounds if that order holds:
        no estimate and no interval, but an audit of the order. Its target is met when half the
        bracket is at most `relative_half_width` times its middle.
    batch_size : int
        Most simulator runs asked for at a time. The search for a first crash and its edge asks for
        one at a time; up to ten, rounds that learn ask for five; later rounds are at most half of
        the runs before them, and the last no larger than the target needs. Larger batches take more
        runs.
    earlier_targets : sequence of (float, int)
        Half-widths that a resumed campaign aimed at before, each until so many simulator runs.
    earlier_budgets : sequence of (int, int)
        Its budgets before, likewise.
    consequences : sequence of str
        Names of numbers in [0, 1] that a run tells beside the event and that are 0 where it did not
        happen: the expected injury, or whether a narrower event happened too. The estimate gives
        the expectation of each. Only by the method "sequential", with the goal "probability".
    aim : str, optional
        The consequence that the target is for, and that the runs are chosen to estimate; the
        event's probability where not given.

    Raises
    ------
    InvalidInputError
        If an argument is not as described.

    Examples
    --------
    >>> campaign = Campaign(traffic, risk={"v_lead": "decreasing"}, seed=0)  # doctest: +SKIP
    >>> while not campaign.done:  # doctest: +SKIP
    ...     campaign.tell(simulate(campaign.ask()))
    >>> campaign.estimate().interval  # doctest: +SKIP
    """

    def __init__(
        self,
        traffic: TrafficModel,
        *,
        risk: Mapping[str, Any] | None = None,
        seed: int = 0,
        relative_half_width: float = 0.1,
        max_calls: int = 2000,
        confidence: float = 0.95,
        method: str = "sequential",
        goal: str = "probability",
        batch_size: int = 10,
        earlier_targets: Sequence[tuple[float, int]] = (),
        earlier_budgets: Sequence[tuple[int, int]] = (),
        consequences: Sequence[str] = (),
        aim: str | None = None,
    ) -> None:
        steps = method_for(method, goal, ordered=risk is not None)
        names = declared(consequences, aim, method, goal)
        if not isinstance(traffic, TrafficModel):
            raise InvalidInputError(
                "traffic: expected a TrafficModel, as TrafficModel.from_json(…) gives, got "
                f"{type(traffic).__name__}."
            )
        order = None if risk is None else RiskOrder.from_mapping(risk, traffic.names)
        self._traffic, self._order = traffic, order
        # methods work where the components are normal; situations come out in the variables' units
        modelled = _asked_of(traffic, method, goal)
        self._problem = Problem(
            traffic=modelled.average,
            ensemble=modelled if modelled.members else None,
            order=order and order.on(traffic.scales),
            relative_half_width=relative_half_width,
            max_calls=max_calls,
            confidence=confidence,
            batch_size=batch_size,
            seed=seed,
            earlier_targets=tuple((float(t), int(n)) for t, n in earlier_targets),
            earlier_budgets=tuple((int(b), int(n)) for b, n in earlier_budgets),
            consequences=names,
            aim=aim,
        )
        self._method, self._goal = method, goal
        self._steps = steps(self._problem)
        self._pending: FloatArray | None = None
        self._snapshot = Snapshot()
        self._asked: list[FloatArray] = []
        self._told: list[FloatArray] = []  # tables (n, 1 + K)
        self._history: list[HistoryPoint] = []
        self._taken = False

    @property
    def problem(self) -> Problem:
        """What is asked: traffic model, risk order, target and budget."""
        return self._problem

    @property
    def method(self) -> str:
        """The name of the method."""
        return self._method

    @property
    def goal(self) -> str:
        """What the simulator runs are spent on: "probability" or "bounds"."""
        return self._goal

    @property
    def snapshot(self) -> Snapshot:
        """What the method knows now, the learned set included."""
        return self._snapshot

    @property
    def done(self) -> bool:
        """Whether no more situations will be asked for."""
        self._start()
        return self._pending is None

    @property
    def n_calls(self) -> int:
        """Simulator runs told so far."""
        return sum(len(y) for y in self._told)

    @property
    def n_failed(self) -> int:
        """Those of them that failed."""
        return int(np.count_nonzero(np.isnan(self.outcomes)))

    @property
    def x(self) -> FloatArray:
        """Situations simulated so far, shape (n_calls, d)."""
        return np.concatenate([np.empty((0, self._problem.traffic.n_variables)), *self._asked])

    @property
    def outcomes(self) -> FloatArray:
        """Their outcomes, shape (n_calls,): 1 crash, 0 safe, NaN failed."""
        return np.concatenate([np.empty(0), *(table[:, 0] for table in self._told)])

    @property
    def consequences(self) -> FloatArray:
        """Their consequences, shape (n_calls, K), NaN where the simulation failed."""
        none = np.empty((0, len(self._problem.consequences)))
        return np.concatenate([none, *(table[:, 1:] for table in self._told)])

    def ask(self) -> FloatArray:
        """The next situations to simulate, shape (n, d) in the traffic model's variables.

        Raises
        ------
        CallOrderError
            If the outcomes of the last ones were not told, or the campaign is done.
        """
        self._start()
        if self._pending is None:
            raise CallOrderError(
                f"ask: the campaign is done ({self._snapshot.stop_reason}); "
                "read campaign.estimate()."
            )
        if self._taken:
            raise CallOrderError(
                f"ask: expected the outcomes of the last {len(self._pending)} situations first; "
                "call campaign.tell(outcomes)."
            )
        self._taken = True
        return self._pending.copy()

    def tell(self, outcomes: Told) -> None:
        """Take the outcomes of the situations asked for: True or 1 a crash, False or 0 safe.

        Parameters
        ----------
        outcomes : array_like, shape (n,)
            In the order of `ask`. NaN says that the simulation failed: never "safe". With K
            consequences, shape (n, 1 + K), the outcomes in the first column and then each
            consequence in the order declared; or a mapping of names to arrays (n,), whose one key
            that names no consequence is the event's.

        Raises
        ------
        CallOrderError
            If nothing was asked.
        InvalidInputError
            If there is not one outcome per situation, or one is not 0, 1 or NaN; or a consequence
            is not in [0, 1], or above 0 where the event did not happen.
        """
        if self._pending is None or not self._taken:
            raise CallOrderError("tell: nothing was asked; call campaign.ask() first.")
        n, names = len(self._pending), self._problem.consequences
        table = told_table(outcomes, n, names)
        self._asked.append(self._pending)
        self._told.append(table)
        self._taken = False
        if self._hopeless():
            self._pending = None
            self._snapshot = replace(self._snapshot, stop_reason=StopReason.ALL_FAILED)
        else:
            self._advance(lambda: self._steps.send(table if names else table[:, 0]))
        self._history.append(self._history_point())

    def estimate(self) -> Estimate:
        """The estimate as it stands."""
        s, y = self._snapshot, self.outcomes
        n_crashes = int(np.count_nonzero(y == 1))
        return Estimate(
            probability=s.probability,
            interval=s.interval,
            confidence=self._problem.confidence,
            standard_error=s.standard_error,
            bounds=s.bounds,
            n_calls=len(y),
            n_crashes=n_crashes,
            n_failed=self.n_failed,
            n_eff=s.n_eff,
            largest_weight_share=s.largest_weight_share,
            log_efficiency=s.log_efficiency,
            alarms=_alarms(s, y),
            stop_reason=s.stop_reason,
            method=self._method,
            seed=self._problem.seed,
            history=tuple(self._history),
            traffic_range=s.traffic_range,
            goal=self._goal,
            order_audit=s.order_audit,
            order_suspect=self._suspect(),
            consequences=s.consequences or unknown(self._problem, s, self.consequences),
        )

    def crash_probability(self, x: npt.ArrayLike) -> FloatArray:
        """What the finished campaign holds about situations x (n, d): P(crash | outcomes), (n,).

        A surrogate's opinion with what the risk order implies: to choose what to look at. The
        answer of a campaign is :meth:`estimate`.

        Raises
        ------
        CallOrderError
            If the campaign is not done, or ended without having learned a crash set.
        InvalidInputError
            If x has another shape, or is not finite.
        """
        belief = self._snapshot.belief
        if belief is None:
            raise CallOrderError(
                "crash_probability: expected a campaign that is done and has found crashes by the "
                f"method 'sequential'; this one is {self._snapshot.stop_reason.value!r} after "
                f"{self.n_calls} simulator runs by {self._method!r}."
            )
        rows = as_rows(x, self._traffic.n_variables)
        return belief(self._traffic.scales.forward(rows))

    def _start(self) -> None:
        if self._pending is None and not self._told and self._running():
            self._advance(lambda: next(self._steps))

    def _hopeless(self) -> bool:
        return self.n_calls >= MAX_FAILURES and bool(np.isnan(self.outcomes).all())

    def _running(self) -> bool:
        return self._snapshot.stop_reason is StopReason.RUNNING

    def _advance(self, step: Callable[[], Query]) -> None:
        # One BLAS thread: the same bits whatever the machine's load, and faster on small matrices.
        from threadpoolctl import threadpool_limits

        try:
            with threadpool_limits(limits=1):
                query = step()
        except StopIteration as end:
            self._pending, self._snapshot = None, end.value
        else:
            self._pending = self._traffic.from_modelled(query.x)
            self._snapshot = query.snapshot

    def _suspect(self) -> Suspect | None:
        """The direction to look at; not where the outcomes' own sense is what is in doubt."""
        alarms = set(self._snapshot.alarms)
        if not self._order or not alarms & {Alarm.ORDER_CONTRADICTED, Alarm.ORDER_DROPPED}:
            return None
        if self._snapshot.probability > NEARLY_ALL:
            return None
        return suspect(self._order, self.x, self.outcomes)

    def _history_point(self) -> HistoryPoint:
        s = self._snapshot
        return HistoryPoint(self.n_calls, s.probability, *s.interval, s.phase)


def _asked_of(traffic: TrafficModel, method: str, goal: str) -> TrafficModel:
    """The law of z that is asked of; a warning where its members are not told of."""
    if not traffic.members or (method in TELL_MEMBERS and goal == "probability"):
        return traffic.modelled
    if method in TELL_MEMBERS:
        warnings.warn(
            f"goal {goal!r} answers for the average of the traffic model's "
            f"{len(traffic.members)} members alone: its bounds do not say how far the events "
            "determine the probability; the goal 'probability' does.",
            stacklevel=3,
        )
        return traffic.modelled
    warnings.warn(
        f"method {method!r} answers for the best fit alone: the {len(traffic.members) - 1} "
        "further fits of the traffic model are left out, so the answer does not say how far "
        "the events determine it; method 'sequential' does.",
        stacklevel=3,
    )
    return replace(traffic.modelled, members=())


def _alarms(s: Snapshot, y: FloatArray) -> tuple[Alarm, ...]:
    """The method's, and those that hold for any: first what is wrong with the simulator."""
    n_crashes, n_failed = (int(np.count_nonzero(some)) for some in (y == 1, np.isnan(y)))
    ended = s.stop_reason is StopReason.BUDGET_ENDED
    first = {
        Alarm.ALL_FAILED: 0 < n_failed == len(y),
        Alarm.NEARLY_ALL_CRASH: s.probability > NEARLY_ALL,
    }
    last = {
        Alarm.SIMULATIONS_FAILED: 0 < n_failed < len(y),
        Alarm.TOO_FEW_CRASHES: 0 < n_crashes < MIN_CRASHES and np.isfinite(s.probability),
        Alarm.CONSEQUENCE_UNDETERMINED: any(c.rough for c in s.consequences),
        Alarm.TARGET_NOT_REACHED: ended and Alarm.TARGET_UNCHECKED not in s.alarms,
    }
    before, after = ([a for a in some if some[a]] for some in (first, last))
    return tuple(dict.fromkeys((*before, *s.alarms, *after)))
