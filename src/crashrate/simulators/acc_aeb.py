"""The vehicle of the 2017 study: adaptive cruise control and emergency braking behind a cut-in.

A follower behind a lead vehicle that keeps its speed, in one dimension. Control acts every 0.1 s
and holds the acceleration in between, so that the motion is exact.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from crashrate.errors import InvalidInputError
from crashrate.variables import BoolArray, FloatArray, frozen

STEP = 0.1  # s
N_INSTANTS = 81  # control instants, k = 0..80: 8 s

HEADWAY = 2.0  # s, what ACC aims at
PROPORTIONAL_GAIN = -38.6252446973784  # m/s³
INTEGRAL_GAIN = -1.35416845633818  # m/s⁴
ACC_LIMIT = 5.0  # m/s², either way
ACC_TOP_SPEED = 90.0 / 2.236  # m/s, 90 mph: no positive acceleration from there on

AEB_SLOW = 40.0 / 3.6  # m/s, 40 km/h: the trigger's threshold is constant above
AEB_THRESHOLD = 0.91  # s of TTC, above 40 km/h
AEB_THRESHOLD_SLOW = (0.835, 0.0075, 1.111)  # s, s²/m, m/s: T(v) = a + b (v - c) below
AEB_RELEASE = 1.0  # s of TTC
AEB_JERK = 16.0  # m/s³
AEB_LIMIT = 10.0  # m/s²

ACTUATOR_LIMIT = 9.8  # m/s², either way
ACTUATOR_RATE = 20.0  # m/s³, either way, from 0 before the first instant

PUBLISHED_CLOSING_SPEED_CAP = 23.49  # m/s
PUBLISHED_EGO_SPEED_CAP = 35.0  # m/s

BLOCK = 8192  # runs stepped together: their state stays in the processor's cache


@dataclass(frozen=True, eq=False)
class AccAebResult:
    """What happened in each run; the arrays have the shape of the inputs.

    Parameters
    ----------
    crash : bool array
        The range was below zero at a control instant.
    min_range : array, m
        Smallest range over the control instants, the start included; 0 for a crash.
    impact_speed : array, m/s
        Closing speed at the moment when the range is zero; NaN where there is no crash.
    input_altered : bool array
        The caps changed the event: what was simulated is not what was asked for.
    """

    crash: BoolArray
    min_range: FloatArray
    impact_speed: FloatArray
    input_altered: BoolArray


@dataclass(frozen=True)
class AccAeb:
    """Follower with adaptive cruise control and automatic emergency braking.

    Parameters
    ----------
    closing_speed_cap : float or None
        Largest initial closing speed, m/s; a larger one is lowered to it. None: no cap.
    ego_speed_cap : float or None
        Largest initial speed of the follower, m/s; likewise.

    References
    ----------
    Huang, Lam, LeBlanc, Zhao (2017), Accelerated evaluation of automated vehicles using piecewise
    mixture models; the numbers are those of its published model files.
    """

    closing_speed_cap: float | None = None
    ego_speed_cap: float | None = None

    def __post_init__(self) -> None:
        for name in ("closing_speed_cap", "ego_speed_cap"):
            cap = getattr(self, name)
            if cap is not None and not 0.0 < cap < np.inf:
                raise InvalidInputError(
                    f"{name}: expected a positive number of m/s or None, got {cap!r}."
                )

    @classmethod
    def published(cls) -> "AccAeb":
        """The configuration of the 2017 study, which caps both speeds silently."""
        return cls(PUBLISHED_CLOSING_SPEED_CAP, PUBLISHED_EGO_SPEED_CAP)

    def run(
        self,
        *,
        v_lead: npt.ArrayLike,
        range: npt.ArrayLike,  # noqa: A002 - the field's name
        closing_speed: npt.ArrayLike,
    ) -> AccAebResult:
        """Simulate one run per event; the arguments are broadcast against each other.

        Parameters
        ----------
        v_lead : array, m/s
            Speed of the lead vehicle, at least 0.
        range : array, m
            Initial gap, above 0.
        closing_speed : array, m/s
            Initial speed of the follower minus that of the lead; negative where the gap opens.

        Raises
        ------
        InvalidInputError
            If a value is not finite or out of range, or the follower's speed would be negative.
        """
        lead, gap, closing = _checked_inputs(v_lead, range, closing_speed)
        ego, altered = self._initial_speed(lead, closing)
        min_range, impact = _in_blocks(gap, lead, ego)
        crash = ~np.isnan(impact)
        return AccAebResult(
            frozen(crash, np.bool_), frozen(min_range), frozen(impact), frozen(altered, np.bool_)
        )

    def altered(self, *, v_lead: npt.ArrayLike, closing_speed: npt.ArrayLike) -> BoolArray:
        """Which events the caps change, without simulating them."""
        lead, closing = np.broadcast_arrays(
            np.asarray(v_lead, dtype=np.float64), np.asarray(closing_speed, dtype=np.float64)
        )
        return self._initial_speed(lead, closing)[1]

    def _initial_speed(self, lead: FloatArray, closing: FloatArray) -> tuple[FloatArray, BoolArray]:
        """The follower's first speed, m/s, and where the caps lowered it."""
        capped = (
            closing
            if self.closing_speed_cap is None
            else np.minimum(closing, self.closing_speed_cap)
        )
        ego = lead + capped
        if self.ego_speed_cap is not None:
            ego = np.minimum(ego, self.ego_speed_cap)
        return ego, ego < lead + closing


def _checked_inputs(
    v_lead: npt.ArrayLike, range_: npt.ArrayLike, closing_speed: npt.ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray]:
    named = {"v_lead": v_lead, "range": range_, "closing_speed": closing_speed}
    arrays = [np.asarray(value, dtype=np.float64) for value in named.values()]
    try:
        lead, gap, closing = np.broadcast_arrays(*arrays)
    except ValueError:
        shapes = ", ".join(f"{n} {a.shape}" for n, a in zip(named, arrays, strict=True))
        raise InvalidInputError(
            f"expected arrays of one shape, or shapes that broadcast; got {shapes}."
        ) from None
    _require(np.isfinite(lead) & (lead >= 0.0), lead, "v_lead", "a finite speed >= 0 m/s")
    _require(np.isfinite(gap) & (gap > 0.0), gap, "range", "a finite range > 0 m")
    ahead = np.isfinite(closing) & (lead + closing >= 0.0)
    _require(ahead, closing, "closing_speed", "a finite closing speed >= -v_lead, in m/s")
    return lead, gap, closing


def _require(good: BoolArray, values: FloatArray, name: str, expected: str) -> None:
    bad = np.flatnonzero(~good)
    if len(bad):
        raise InvalidInputError(
            f"{name}: expected {expected}, got {values.flat[bad[0]]} at event {bad[0]} "
            f"({len(bad)} such events of {values.size})."
        )


# --- the simulation


class _State(NamedTuple):
    """All running runs at one control instant, each an array (n,)."""

    range: FloatArray  # m
    lead: FloatArray  # m/s
    ego: FloatArray  # m/s
    remembered: FloatArray  # m/s², a_{k-1} of ACC, or of AEB while it brakes
    error: FloatArray  # s, e_{k-1}
    braking: BoolArray
    at_trigger: FloatArray  # m/s², remembered acceleration when AEB came on
    brake_time: FloatArray  # s, 0.1 at the first instant of braking
    output: FloatArray  # m/s², what the actuator gave

    def where(self, kept: BoolArray) -> "_State":
        """The runs that are `kept`."""
        return self._replace(**{name: getattr(self, name)[kept] for name in self._fields})


def _in_blocks(gap: FloatArray, lead: FloatArray, ego: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Smallest range and impact speed of every run, in the shape of the inputs."""
    min_range, impact = np.empty(gap.size), np.empty(gap.size)
    flat = gap.ravel(), lead.ravel(), ego.ravel()
    for start in range(0, gap.size, BLOCK):
        block = slice(start, start + BLOCK)
        min_range[block], impact[block] = _simulate(*(array[block] for array in flat))
    return min_range.reshape(gap.shape), impact.reshape(gap.shape)


def _simulate(gap: FloatArray, lead: FloatArray, ego: FloatArray) -> tuple[FloatArray, FloatArray]:
    min_range, impact = gap.copy(), np.full(len(gap), np.nan)
    running = np.flatnonzero(ego > 0.0)
    rest = np.zeros(len(gap))
    state = _State(gap, lead, ego, rest, rest, rest > 0.0, rest, rest, rest).where(ego > 0.0)
    for _ in range(N_INSTANTS):
        before, state = state, _step(state)
        min_range[running] = np.minimum(min_range[running], np.maximum(state.range, 0.0))
        crashed = state.range < 0.0
        impact[running[crashed]] = _impact_speed(before.where(crashed), state.output[crashed])
        going = (state.range > 0.0) & (state.ego > 0.0)
        if not going.all():  # only the runs that go on are stepped
            running, state = running[going], state.where(going)
    return min_range, impact


def _step(state: _State) -> _State:
    """One control instant and the 0.1 s of motion after it."""
    release, trigger = _aeb_switches(state)
    error, acc = _acc(state, np.where(release, 0.0, state.error))
    braking = (state.braking & ~release) | trigger
    at_trigger = np.where(trigger, state.remembered, state.at_trigger)
    brake_time = np.where(braking & ~trigger, state.brake_time, 0.0) + STEP
    aeb = np.maximum(-AEB_LIMIT, at_trigger - AEB_JERK * brake_time)
    command = np.where(braking, aeb, acc)
    a = _actuator(command, state.output)
    gap = state.range + (state.lead - state.ego) * STEP - a * (STEP**2 / 2.0)
    ego = state.ego + a * STEP
    return _State(gap, state.lead, ego, command, error, braking, at_trigger, brake_time, a)


def _acc(state: _State, last_error: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Headway error e_k, s, and the acceleration that ACC asks for, m/s²."""
    error = HEADWAY - state.range / state.ego
    a = (
        state.remembered
        + PROPORTIONAL_GAIN * (error - last_error)
        + INTEGRAL_GAIN * (STEP / 2.0) * (error + last_error)
    )
    highest = np.where(state.ego >= ACC_TOP_SPEED, 0.0, ACC_LIMIT)
    return error, np.minimum(np.maximum(a, -ACC_LIMIT), highest)


def _aeb_switches(state: _State) -> tuple[BoolArray, BoolArray]:
    """Where AEB goes off and on; TTC = range / closing is compared without dividing by zero."""
    closing = state.ego - state.lead
    release = state.braking & (state.range > AEB_RELEASE * closing)  # TTC > 1 s, or not closing
    base, slope, speed = AEB_THRESHOLD_SLOW
    slow = base + slope * (state.ego - speed)
    threshold = np.where(state.ego < AEB_SLOW, slow, AEB_THRESHOLD)
    trigger = ~state.braking & (closing > 0.0) & (state.range <= threshold * closing)
    return release, trigger


def _actuator(command: FloatArray, output: FloatArray) -> FloatArray:
    """The command within the actuator's limits, and within its rate of the last output."""
    limited = np.minimum(np.maximum(command, -ACTUATOR_LIMIT), ACTUATOR_LIMIT)
    change = ACTUATOR_RATE * STEP
    return np.minimum(np.maximum(limited, output - change), output + change)


def _impact_speed(before: _State, a: FloatArray) -> FloatArray:
    """Closing speed where the range of this step is zero: c² + 2 a R, m/s."""
    closing = before.ego - before.lead
    return np.sqrt(np.maximum(closing**2 + 2.0 * a * before.range, 0.0))
