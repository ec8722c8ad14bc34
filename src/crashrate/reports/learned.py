"""What a run learned, made ready to draw: the monotone set and its dominating points."""

from dataclasses import dataclass

import numpy as np

from crashrate.crash_set.monotone_set import MonotoneSet
from crashrate.crash_set.order import RiskOrder
from crashrate.estimation.alarms import Alarm
from crashrate.reports.axes import Axis, risk_axes
from crashrate.reports.likeliest import by_density
from crashrate.runs.record import RunRecord
from crashrate.variables import FloatArray


@dataclass(frozen=True)
class Learned:
    """The learned set of a run, in risk coordinates u (danger grows in each).

    Parameters
    ----------
    order : RiskOrder
    axes : tuple of Axis, length m
    u : (n, m) array
        Of all simulator runs.
    outcomes : (n,) array
        1 crash, 0 safe, NaN failed.
    monotone : MonotoneSet
    reference : (m,) array
        Where sections are taken: the likeliest crash that no outcome contradicts, or else the
        likeliest crash, or else the likeliest run.
    reference_is_crash : bool
    lower, upper : (m,) arrays
        What of u the figures show.
    """

    order: RiskOrder
    axes: tuple[Axis, ...]
    u: FloatArray
    outcomes: FloatArray
    monotone: MonotoneSet
    reference: FloatArray
    reference_is_crash: bool
    lower: FloatArray
    upper: FloatArray

    @property
    def signs(self) -> FloatArray:
        """Physical quantity = sign × u."""
        return np.array([axis.sign for axis in self.axes])

    def physical(self, u: FloatArray) -> FloatArray:
        """Rows of u in physical units."""
        return u * self.signs

    def limits(self, k: int) -> tuple[float, float]:
        """What the figures show of coordinate `k`, in physical units, ascending."""
        ends = sorted((self.lower[k] * self.signs[k], self.upper[k] * self.signs[k]))
        return float(ends[0]), float(ends[1])

    def axes_to_draw(self) -> tuple[int, ...]:
        """At most three coordinates: those in which the boundary found varies most."""
        m = len(self.axes)
        if m <= 3:
            return tuple(range(m))
        front = np.vstack([self.monotone.minimal_crashes, self.monotone.maximal_safe])
        spread = front.std(axis=0) / np.maximum(self.u.std(axis=0), np.finfo(float).tiny)
        return tuple(sorted(np.argsort(-spread, kind="stable")[:3].tolist()))


def learned_set(record: RunRecord) -> Learned | None:
    """What the run learned; None without a simulator run, or an order that is declared and held."""
    mapping = record.scenario.risk_mapping()
    if mapping is None or not len(record.x) or order_dropped(record):
        return None
    order = RiskOrder.from_mapping(mapping, record.traffic.names)
    u = order(record.x)
    labelled = ~np.isnan(record.outcomes)
    monotone = MonotoneSet.empty(order.n_coordinates).add(
        u[labelled], record.outcomes[labelled] == 1
    )
    crashes = by_density(record, crash=True)
    # a contradicted crash implies nothing: a section through it would show no crash around it
    doubted = np.flatnonzero(labelled)[monotone.contradicted]
    trusted = crashes[~np.isin(crashes, doubted)]
    reference = u[[*trusted, *crashes, _likeliest_run(record)][0]]
    lower, upper = _view(u, monotone)
    return Learned(
        order=order,
        axes=risk_axes(record.scenario, order),
        u=u,
        outcomes=record.outcomes,
        monotone=monotone,
        reference=reference,
        reference_is_crash=bool(len(crashes)),
        lower=lower,
        upper=upper,
    )


def order_dropped(record: RunRecord) -> bool:
    """Whether the campaign gave the declared order up."""
    return any(
        alarm["name"] == Alarm.ORDER_DROPPED.name for alarm in record.result.get("alarms", ())
    )


def _likeliest_run(record: RunRecord) -> int:
    return int(np.argmax(record.traffic.average.log_density(record.x)))


def _view(u: FloatArray, monotone: MonotoneSet) -> tuple[FloatArray, FloatArray]:
    """The box to show: the fronts and most runs; far exploration would squeeze all the rest."""
    core = np.quantile(u, [0.05, 0.95], axis=0)
    shown = np.vstack([core, monotone.minimal_crashes, *_nearby(monotone.maximal_safe, u)])
    lower, upper = shown.min(axis=0), shown.max(axis=0)
    margin = 0.06 * (upper - lower)
    margin = np.where(margin > 0, margin, np.maximum(0.5 * np.abs(upper), 1.0))
    return lower - margin, upper + margin


def _nearby(points: FloatArray, u: FloatArray) -> tuple[FloatArray, ...]:
    low, high = np.quantile(u, [0.02, 0.98], axis=0)
    return (points[((points >= low) & (points <= high)).all(axis=1)],)
