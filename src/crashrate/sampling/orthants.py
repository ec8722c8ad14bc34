"""Dominating points of every component of a traffic model in every orthant {x: u(x) >= apex}.

The apexes are the minimal crashes, for the inner set, or the corners, for the outer one; the
truncation box is a constraint like any other (§VI.B of the 2017 paper).
"""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from crashrate.crash_set.order import RiskOrder
from crashrate.sampling.curved import CurvedConstraint, curved_dominating_point
from crashrate.sampling.dominating_points import Whitening
from crashrate.traffic.model import TrafficModel
from crashrate.traffic.truncated_normal import log_box_probability
from crashrate.variables import FloatArray, as_rows, frozen

Integers = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class DominatingPoints:
    """A_I or A_O of the 2017 paper: at most one point for each component and orthant.

    Attributes
    ----------
    points : (n, d) array
    component : (n,) integer array
        Whose dominating point it is, i in the paper.
    orthant : (n,) integer array
        In which orthant: a row of `apexes`.
    log_masses : (n,) array
        Log probability of the truncation box under the component moved to the point.
    apexes : (l, m) array
        The orthants {x: u(x) >= apex}; an entry of -inf sets no constraint.
    n_unsolved : int
        Pairs of component and orthant left out: the orthant misses the truncation box, or a curved
        constraint defeated the solver.
    """

    points: FloatArray
    component: Integers
    orthant: Integers
    log_masses: FloatArray
    apexes: FloatArray
    n_unsolved: int

    def of_component(self, i: int) -> FloatArray:
        """The points of component i, (n_i, d)."""
        chosen: FloatArray = self.points[self.component == i]
        return chosen


class Orthant(NamedTuple):
    """{x in the box: u(x) >= apex} as a polyhedron and what is left over."""

    normals: FloatArray
    offsets: FloatArray
    curved: tuple[CurvedConstraint, ...]


def orthant_constraints(order: RiskOrder, apex: FloatArray, traffic: TrafficModel) -> Orthant:
    """The constraints of {u(x) >= apex} and of the truncation box.

    Parameters
    ----------
    order : RiskOrder
    apex : (m,) array
        Entries of -inf set no constraint.
    traffic : TrafficModel
        For its box.
    """
    eye = np.eye(traffic.n_variables)
    low, high = np.isfinite(traffic.lower), np.isfinite(traffic.upper)
    normals = [eye[low], -eye[high]]
    offsets = [traffic.lower[low], -traffic.upper[high]]
    curved = []
    for k in np.flatnonzero(apex > -np.inf):
        half_space = order.half_space(int(k), float(apex[k]), traffic.lower, traffic.upper)
        if half_space is None:
            curved.append(CurvedConstraint(partial(order.coordinate, int(k)), float(apex[k])))
        else:
            normals.append(half_space.normal[None])
            offsets.append(np.array([half_space.offset]))
    return Orthant(np.vstack(normals), np.concatenate(offsets), tuple(curved))


def dominating_points(
    traffic: TrafficModel,
    order: RiskOrder,
    apexes: npt.ArrayLike,
    known: DominatingPoints | None = None,
) -> DominatingPoints:
    """Solve max φ(x; µ_i, Σ_i) subject to u(x) >= apex and x in the box, for all i and apexes.

    Parameters
    ----------
    traffic : TrafficModel
    order : RiskOrder
        On the traffic model's variables.
    apexes : (l, m) array
    known : DominatingPoints, optional
        Of the same traffic model and order: apexes found there are not solved again.

    Raises
    ------
    InvalidInputError
        If the apexes have another number of columns.
    NumericalError
        If a polyhedron's dominating point misses its optimality conditions.
    """
    rows = np.asarray(apexes, dtype=np.float64)
    as_rows(np.where(rows == -np.inf, 0.0, rows), order.n_coordinates, "apexes")
    components = [
        Whitening.of(m, c) for m, c in zip(traffic.means, traffic.covariances, strict=True)
    ]
    solved = {} if known is None else _by_apex(known)
    found: list[_Found] = []
    # one thread: on matrices this small, handing work to others costs more than the work
    with threadpool_limits(limits=1, user_api="blas"):
        for j, apex in enumerate(rows):
            here = solved.get(apex.tobytes())
            if here is None:
                here = _solve(components, orthant_constraints(order, apex, traffic))
            found += [f._replace(orthant=j) for f in here]
        log_masses = _log_masses(traffic, found)
    return DominatingPoints(
        points=frozen(np.reshape([f.x for f in found], (len(found), traffic.n_variables))),
        component=frozen([f.component for f in found], np.intp),
        orthant=frozen([f.orthant for f in found], np.intp),
        log_masses=frozen(log_masses),
        apexes=frozen(rows),
        n_unsolved=len(components) * len(rows) - len(found),
    )


class _Found(NamedTuple):
    """One dominating point; its mass is NaN until it is known."""

    x: FloatArray
    component: int
    orthant: int = -1
    log_mass: float = np.nan


def _solve(components: list[Whitening], orthant: Orthant) -> list[_Found]:
    """Dominating points of the components in one orthant, where there is one."""
    found = []
    for i, component in enumerate(components):
        x = component.dominating_point(orthant.normals, orthant.offsets)
        if x is None:  # the orthant misses the box, whatever the component
            return []
        if orthant.curved:
            x = curved_dominating_point(component, *orthant, start=x)
        if x is not None:
            found.append(_Found(x, i))
    return found


def _log_masses(traffic: TrafficModel, found: list[_Found]) -> FloatArray:
    log_masses = np.array([f.log_mass for f in found])
    new = np.flatnonzero(np.isnan(log_masses))
    if len(new):
        covariances = traffic.covariances[[found[n].component for n in new]]
        points = np.array([found[n].x for n in new])
        log_masses[new] = log_box_probability(points, covariances, traffic.lower, traffic.upper)
    return log_masses


def _by_apex(known: DominatingPoints) -> dict[bytes, list[_Found]]:
    solved: dict[bytes, list[_Found]] = {a.tobytes(): [] for a in known.apexes}
    rows = zip(known.points, known.component, known.orthant, known.log_masses, strict=True)
    for x, i, j, log_mass in rows:
        solved[known.apexes[j].tobytes()].append(_Found(x, int(i), int(j), float(log_mass)))
    return solved
