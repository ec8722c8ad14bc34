"""Monotone set: what labels and the risk order together say about the crash set."""

from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property

import numpy as np
import numpy.typing as npt

from crashrate.crash_set.corners import corners_of
from crashrate.crash_set.fronts import (
    above_any,
    below_any,
    insert_maximal,
    insert_minimal,
    maximal,
    minimal,
)
from crashrate.errors import InvalidInputError
from crashrate.variables import BoolArray, FloatArray, as_rows, frozen

Labels = npt.NDArray[np.int8]


class Label(IntEnum):
    """What is implied about a situation."""

    UNDECIDED = -1
    SAFE = 0
    CRASH = 1


@dataclass(frozen=True, eq=False)
class MonotoneSet:
    """A crash set in risk coordinates, between an inner and an outer set.

    Danger grows in every coordinate of u: u >= a crash is a crash, u <= a safe point is safe, in
    the weak componentwise order; everything else is undecided. A label is *contradicted* when the
    order and another label say the opposite of it: a crash <= a safe point (or equal to it)
    contradicts both. A contradicted label implies nothing; which labels are contradicted depends
    on the labels seen, not on their sequence.

    Made with `empty` and `add`; never changed.

    Attributes
    ----------
    u : (n, m) array
        All labelled points, in the order in which they were added.
    crash : (n,) bool array
        Their labels.
    contradicted : (n,) bool array
        Labels that another label contradicts.
    minimal_crashes : (n1, m) array
        S_1 of the 2017 paper: Pareto-minimal crashes.
    maximal_safe : (n0, m) array
        S_0: Pareto-maximal safe points.
    """

    u: FloatArray
    crash: BoolArray
    contradicted: BoolArray
    minimal_crashes: FloatArray
    maximal_safe: FloatArray

    @classmethod
    def empty(cls, m: int) -> "MonotoneSet":
        """Nothing known yet about `m` risk coordinates.

        Raises
        ------
        InvalidInputError
            If m < 1.
        """
        if m < 1:
            raise InvalidInputError(f"m: expected at least one risk coordinate, got {m}.")
        none, no = frozen(np.empty((0, m))), frozen([], np.bool_)
        return cls(none, no, no, none, none)

    @property
    def n_coordinates(self) -> int:
        """Number m of risk coordinates."""
        return int(self.u.shape[1])

    @cached_property
    def corners(self) -> FloatArray:
        """Minimal corners of the outer set, (nc, m).

        The outer set is, up to its boundary, the union of the orthants {u >= corner}; -inf where a
        corner does not bound a coordinate. Made when asked for: their number is Θ(n^⌊m/2⌋) for n
        safe points, which a campaign in ten coordinates could not wait for.
        """
        return frozen(corners_of(self.maximal_safe))

    @property
    def contradictions(self) -> int:
        """Number of labels that another label contradicts."""
        return int(self.contradicted.sum())

    def add(self, u: npt.ArrayLike, crash: npt.ArrayLike) -> "MonotoneSet":
        """The set with more labels, taken one by one.

        Parameters
        ----------
        u : (m,) or (k, m) array
            Risk coordinates, finite.
        crash : bool, or (k,) bool array
            Their labels. (A failed simulation has no label: leave it out.)

        Raises
        ------
        InvalidInputError
            If the shapes do not match, u is not finite, or `crash` is not boolean.
        """
        rows = as_rows(np.atleast_2d(np.asarray(u, dtype=np.float64)), self.n_coordinates, "u")
        labels = _as_labels(crash, len(rows))
        updated = self
        for row, label in zip(rows, labels, strict=True):
            updated = updated._add_one(row, bool(label))
        return updated

    def _add_one(self, point: FloatArray, crash: bool) -> "MonotoneSet":
        against = self._opposed(point, crash=crash)
        contradicted = np.append(self.contradicted | against, against.any())
        seen = replace(
            self,
            u=frozen(np.vstack([self.u, point])),
            crash=frozen(np.append(self.crash, crash), np.bool_),
            contradicted=frozen(contradicted, np.bool_),
        )
        if against.any():
            # the labels just contradicted must leave the fronts, unless they had left before
            return seen if self.contradicted[against].all() else _rebuilt(seen)
        if crash:
            front = insert_minimal(self.minimal_crashes, point)
            return replace(seen, minimal_crashes=frozen(front))
        front = insert_maximal(self.maximal_safe, point)
        if front is self.maximal_safe:
            return seen
        return replace(seen, maximal_safe=frozen(front))

    def _opposed(self, point: FloatArray, *, crash: bool) -> BoolArray:
        """Labels seen that contradict the label `crash` of `point`: safe ones above a crash, …"""
        if crash:
            return ~self.crash & (self.u >= point).all(axis=1)
        return self.crash & (self.u <= point).all(axis=1)

    def classify(self, u: npt.ArrayLike) -> Labels:
        """What is implied about the points u (n, m): an (n,) int8 array of `Label` values."""
        rows = as_rows(u, self.n_coordinates, "u")
        labels = np.full(len(rows), Label.UNDECIDED, dtype=np.int8)
        # no point gets both: a crash <= u <= a safe point would contradict each other
        labels[above_any(rows, self.minimal_crashes)] = Label.CRASH
        labels[below_any(rows, self.maximal_safe)] = Label.SAFE
        return labels

    def in_inner(self, u: npt.ArrayLike) -> BoolArray:
        """Which points of u (n, m) are implied to crash: (n,)."""
        return above_any(as_rows(u, self.n_coordinates, "u"), self.minimal_crashes)

    def in_outer(self, u: npt.ArrayLike) -> BoolArray:
        """Which points of u (n, m) are not implied to be safe: (n,)."""
        return ~below_any(as_rows(u, self.n_coordinates, "u"), self.maximal_safe)


def _rebuilt(s: MonotoneSet) -> MonotoneSet:
    """`s` with fronts made anew from the labels that nothing contradicts."""
    trusted = ~s.contradicted
    return replace(
        s,
        minimal_crashes=frozen(minimal(s.u[trusted & s.crash])),
        maximal_safe=frozen(maximal(s.u[trusted & ~s.crash])),
    )


def _as_labels(crash: npt.ArrayLike, n: int) -> BoolArray:
    labels = np.atleast_1d(np.asarray(crash))
    if labels.shape != (n,):
        raise InvalidInputError(
            f"crash: expected one label per point, shape ({n},), got {labels.shape}."
        )
    # an empty list arrives as floats
    if labels.dtype != np.bool_ and labels.size:
        raise InvalidInputError(f"crash: expected booleans, got dtype {labels.dtype}.")
    return labels.astype(np.bool_)
