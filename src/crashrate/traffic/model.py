"""The traffic model: how often each situation occurs, as a truncated Gaussian mixture."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from crashrate.errors import InvalidInputError
from crashrate.traffic.log_mixture import LogMixture
from crashrate.traffic.model_checks import (
    check_draws,
    checked_members,
    checked_names,
    checked_shapes,
    checked_weights,
    json_provenance,
)
from crashrate.traffic.model_json import from_document, to_document
from crashrate.traffic.sampling import TruncatedNormals
from crashrate.traffic.scales import Scales
from crashrate.traffic.truncated_normal import box_moments, log_box_probability
from crashrate.variables import FloatArray, as_rows, frozen, numbers

# A component that puts less than this in the box is a numerical accident, not a fit.
_MIN_LOG_MASS = -690.0  # 1e-300


@dataclass(frozen=True, eq=False)
class TrafficModel:
    """A mixture of normals truncated to a box (paper, eq. 2).

    The density is sum_k w_k N(z; m_k, C_k) / P_k |dz/dx| on the box, where P_k is the probability
    of the box under the untruncated component, and 0 outside. z is x, the situation in the
    variables' units, with the logarithm of the variables on a log scale. Methods take and give x.

    Parameters
    ----------
    weights : array_like (K,)
        Weights of the truncated components.
    means : array_like (K, d)
        Means of the untruncated components, in z.
    covariances : array_like (K, d, d)
        Their covariances.
    lower, upper : array_like (d,)
        The box in the variables' units, infinite where there is no limit; from 0 up where the
        scale is log.
    names : sequence of str
        Names of the d variables, Python identifiers.
    provenance : mapping, optional
        Where the numbers come from: anything that JSON can hold.
    scales : sequence of {"linear", "log"}, optional
        Of each variable; linear by default.
    members : sequence of TrafficModel, optional
        Other laws that the events allow, of the same variables, box and scales: their spread says
        what the events do not decide.

    Attributes
    ----------
    log_masses : ndarray (K,)
        Log probability P_k of the box under each untruncated component.
    component_means : ndarray (K, d)
        Means of the truncated components, inside the box, in z.
    mean, covariance : ndarray (d,), (d, d)
        Moments of the mixture, in z.
    modelled : TrafficModel
        The law of z, every scale linear: itself where z is x.

    Raises
    ------
    InvalidInputError
        If shapes do not fit, weights are not a distribution, a covariance is not positive
        definite, a name is bad, a scale does not fit its variable's bounds, or a component has
        practically no mass in the box.
    """

    weights: FloatArray
    means: FloatArray
    covariances: FloatArray
    lower: FloatArray
    upper: FloatArray
    names: tuple[str, ...]
    provenance: Mapping[str, Any] = field(default_factory=dict)
    scales: Scales = None  # type: ignore[assignment] # names become Scales
    members: Sequence["TrafficModel"] = ()
    log_masses: FloatArray = field(init=False, repr=False)
    component_means: FloatArray = field(init=False, repr=False)
    mean: FloatArray = field(init=False, repr=False)
    covariance: FloatArray = field(init=False, repr=False)
    _mixture: LogMixture = field(init=False, repr=False)
    _low: FloatArray = field(init=False, repr=False)
    _high: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._set(names=checked_names(self.names), provenance=json_provenance(self.provenance))
        for name in ("weights", "means", "covariances", "lower", "upper"):
            self._set(**{name: frozen(numbers(getattr(self, name), name))})
        if not isinstance(self.scales, Scales):
            self._set(scales=Scales.parse(self.scales, len(self.names)))
        checked_shapes(self)
        self._set(members=tuple(self.members))
        checked_members(self)
        self._set(
            weights=frozen(checked_weights(self.weights)),
            _low=frozen(self.scales.forward(self.lower)),
            _high=frozen(self.scales.forward(self.upper)),
        )
        self._set_moments()
        self._set(_mixture=self._log_mixture())

    def _set(self, **values: Any) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def _set_moments(self) -> None:
        """Masses of the components, and the mean and covariance of the mixture."""
        parts = box_moments(self.means, self.covariances, self._low, self._high)
        worst = int(np.argmin(parts.log_probability))
        if parts.log_probability[worst] < _MIN_LOG_MASS:
            raise InvalidInputError(
                f"component {worst}: expected some of its mass in the box, got a log probability "
                f"of {parts.log_probability[worst]:.4g}; its mean {self.means[worst]} lies too "
                f"many standard deviations outside [{self._low}, {self._high}]."
            )
        mean = self.weights @ parts.mean
        spread = parts.mean - mean
        between = np.einsum("k,ki,kj->ij", self.weights, spread, spread)
        covariance = np.einsum("k,kij->ij", self.weights, parts.covariance) + between
        self._set(
            log_masses=frozen(parts.log_probability),
            component_means=frozen(parts.mean),
            mean=frozen(mean),
            covariance=frozen(covariance),
        )

    def _log_mixture(self) -> LogMixture:
        return LogMixture.of(
            self.weights,
            self.log_masses,
            self.means,
            self.covariances,
            shift=self.mean,
            scale=np.sqrt(np.diagonal(self.covariance)),
        )

    @property
    def n_components(self) -> int:
        """Number K of components."""
        return len(self.weights)

    @property
    def n_variables(self) -> int:
        """Number d of variables."""
        return len(self.names)

    @property
    def component_masses(self) -> FloatArray:
        """Probability (K,) of the box under each untruncated component."""
        return np.exp(self.log_masses)

    def sample(self, n: int, rng: np.random.Generator | int | None = None) -> FloatArray:
        """Independent draws (n, d), in random order.

        Parameters
        ----------
        n : int
        rng : numpy.random.Generator or int, optional
            A generator, or the seed of one.

        Raises
        ------
        InvalidInputError
            If n is no whole number, or negative.
        """
        check_draws(n)
        generator = np.random.default_rng(rng)
        x, _ = self.sample_components(n, generator)
        return np.asarray(x[generator.permutation(n)])  # rows shuffled in place take twice as long

    def sample_components(
        self, n: int, rng: np.random.Generator
    ) -> tuple[FloatArray, npt.NDArray[np.int64]]:
        """Draws (n, d) grouped by component, and the component (n,) of each."""
        counts = rng.multinomial(n, self.weights)
        parts = [self._laws.sample(k, n_k, rng) for k, n_k in enumerate(counts.tolist()) if n_k]
        x = self.from_modelled(np.concatenate([np.empty((0, self.n_variables)), *parts]))
        return x, np.repeat(np.arange(self.n_components), counts)

    @cached_property
    def _laws(self) -> TruncatedNormals:
        return TruncatedNormals.of(self.means, self.covariances, self._low, self._high)

    @cached_property
    def modelled(self) -> "TrafficModel":
        """The law of z, in which every component is a normal; see :meth:`from_modelled`."""
        if self.scales.linear:
            return self
        return replace(
            self,
            lower=self._low,
            upper=self._high,
            scales=Scales.parse(None, self.n_variables),
            members=tuple(member.modelled for member in self.members),
        )

    @cached_property
    def average(self) -> "TrafficModel":
        """The mixture of the members in equal shares: itself where it has none."""
        if not self.members:
            return self
        shares = [member.weights / len(self.members) for member in self.members]
        return replace(
            self,
            weights=np.concatenate(shares),
            means=np.concatenate([member.means for member in self.members]),
            covariances=np.concatenate([member.covariances for member in self.members]),
            members=(),
        )

    def member_ratios(self, x: npt.ArrayLike) -> FloatArray:
        """Density of each of the M members over that of the average, at rows x: (n, M)."""
        return self.member_densities(x)[1]

    def member_densities(self, x: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Log density (n,) of the average at rows x, and the members' ratios to it: (n, M)."""
        rows, average = as_rows(x, self.n_variables), self.average
        starts = np.cumsum([0, *(member.n_components for member in self.members[:-1])])
        log_density, ratios = np.empty(len(rows)), np.empty((len(rows), len(self.members)))
        z = self._modelled_rows(rows)  # that of the average, on the same scales
        for block in average._mixture.blocks(z):  # noqa: SLF001 - a model too
            log_density[block.rows] = block.logs
            parts = np.add.reduceat(block.powers, starts, axis=0)
            ratios[block.rows] = (parts * (len(self.members) / block.totals)).T
        return self._in_the_box(log_density, rows, z), ratios

    def from_modelled(self, z: FloatArray) -> FloatArray:
        """Situations x (n, d) of rows z (n, d): in the box where z is, rounding or not."""
        if self.scales.linear:
            return z
        return np.clip(self.scales.back(z), self.lower, self.upper)

    def contains(self, x: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Which rows (n, d) lie in the box, sides included (but no logarithm of 0): (n,)."""
        rows = as_rows(x, self.n_variables)
        within = np.ones(len(rows), dtype=bool)
        sides = zip(rows.T, self.lower, self.upper, self.scales.log, strict=True)
        for column, low, high, log in sides:  # a sixth of the time that rows so short take
            within &= (column >= low) & (column <= high)
            if log:
                within &= column > 0.0
        return within

    def log_density(self, x: npt.ArrayLike, *, fast: bool = False) -> FloatArray:
        """Log density (n,) of rows (n, d); -inf outside the box.

        Parameters
        ----------
        x : array_like, shape (n, d)
        fast : bool
            With the compiled kernel of `crashrate[fast]`: half the time a row, but half a second
            before a process's first such call (seconds once, to compile), so it gains from tens
            of millions of rows on. The last bits differ: nothing in a campaign asks for it.

        Raises
        ------
        InvalidInputError
            If x has another shape, or a value that is not finite.
        MissingExtraError
            If `fast`, and numba is not installed.
        """
        rows = as_rows(x, self.n_variables)
        z = self._modelled_rows(rows)
        return self._in_the_box(self._mixture.log_density(z, fast=fast), rows, z)

    def log_component_densities(self, x: npt.ArrayLike) -> FloatArray:
        """log w_k g_k(x) of every component: (n, K); -inf outside the box."""
        rows = as_rows(x, self.n_variables)
        z = self._modelled_rows(rows)
        return self._in_the_box(self._mixture.log_terms(z), rows, z)

    def _in_the_box(self, log_density: FloatArray, rows: FloatArray, z: FloatArray) -> FloatArray:
        """Log densities (n, …) of x from those of z, in their place; -inf outside the box."""
        if not self.scales.linear:
            jacobian = self.scales.log_jacobian(z)
            log_density += jacobian if log_density.ndim == 1 else jacobian[:, None]
        within = self.contains(rows)
        if not within.all():
            log_density[~within] = -np.inf
        return log_density

    def component_probabilities(self, x: npt.ArrayLike) -> FloatArray:
        """Probability (n, K) that each row came from each component (paper, eq. 3)."""
        rows = as_rows(x, self.n_variables)
        return self._mixture.shares(self._modelled_rows(rows))

    def _modelled_rows(self, rows: FloatArray) -> FloatArray:
        """z of rows x; any finite number where there is none, for that is outside the box."""
        if self.scales.linear:
            return rows
        return self.scales.forward(np.where(self.scales.log & (rows <= 0.0), 1.0, rows))

    def box_probability(self, lo: npt.ArrayLike, hi: npt.ArrayLike) -> FloatArray:
        """Probability of boxes under the model, without sampling.

        Parameters
        ----------
        lo, hi : array_like (m, d) or (d,)
            Sides of the boxes, infinite where there is none; a box with lo >= hi is empty.

        Returns
        -------
        ndarray
            (m,), or a scalar array where both `lo` and `hi` are single.

        Raises
        ------
        InvalidInputError
            If shapes do not fit, or a side is nan.
        """
        low, high = self._boxes(lo, hi)
        single = low.ndim == 1
        low, high = np.atleast_2d(low), np.atleast_2d(high)
        out = np.zeros(len(low))
        there = np.flatnonzero((low < high).all(axis=1))
        if len(there):
            parts = self._log_box_parts(low[there], high[there])
            out[there] = np.exp(parts - self.log_masses) @ self.weights
        return out[0] if single else out

    def _boxes(self, lo: npt.ArrayLike, hi: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """The parts of the boxes inside the model's own."""
        low, high = np.asarray(lo, float), np.asarray(hi, float)
        for what, side in (("lo", low), ("hi", high)):
            if side.shape[-1:] != (self.n_variables,) or side.ndim > 2 or np.isnan(side).any():
                raise InvalidInputError(
                    f"{what}: expected numbers (m, {self.n_variables}) or "
                    f"({self.n_variables},) for {', '.join(self.names)}, got {side.shape}"
                    f"{' with nan in it' if np.isnan(side).any() else ''}."
                )
        try:
            low, high = np.broadcast_arrays(low, high)
        except ValueError:
            raise InvalidInputError(
                f"lo and hi: expected as many boxes in both, got {low.shape} and {high.shape}."
            ) from None
        return np.maximum(low, self.lower), np.minimum(high, self.upper)

    def _log_box_parts(self, low: FloatArray, high: FloatArray) -> FloatArray:
        """Log probability (m, K) of non-empty boxes under each untruncated component."""
        m, k = len(low), self.n_components
        log_p = log_box_probability(
            np.tile(self.means, (m, 1)),
            np.tile(self.covariances, (m, 1, 1)),
            np.repeat(self.scales.forward(low), k, axis=0),
            np.repeat(self.scales.forward(high), k, axis=0),
        )
        return log_p.reshape(m, k)

    def to_json(self, path: str | Path | None = None) -> str:
        """The model as JSON text, floats exact; also written to `path` where one is given."""
        text = json.dumps(to_document(self), indent=1) + "\n"
        if path is not None:
            Path(path).write_text(text, encoding="utf-8")
        return text

    @classmethod
    def from_json(cls, text_or_path: str | Path) -> "TrafficModel":
        """A model from its JSON text, or from the file that holds it.

        Raises
        ------
        InvalidInputError
            If there is no such file, or it is not the JSON of a traffic model.
        """
        arguments = from_document(text_or_path)
        members = [cls(**member) for member in arguments.pop("members")]
        return cls(**arguments, members=members)

    def __reduce__(self) -> tuple[type["TrafficModel"], tuple[Any, ...]]:
        # Through the constructor, so that a copy's arrays are read-only too.
        names = ("weights", "means", "covariances", "lower", "upper", "names", "provenance")
        own = [getattr(self, name) for name in names]
        return TrafficModel, (*own, self.scales, self.members)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, TrafficModel):
            return NotImplemented
        return to_document(self) == to_document(other)

    def __hash__(self) -> int:
        return hash((self.names, self.weights.tobytes(), self.means.tobytes()))


def default_names(d: int) -> Sequence[str]:
    """x0, x1, ...: names for variables that have none."""
    return tuple(f"x{i}" for i in range(d))
