"""Proposals of the 2017 paper: truncated Gaussian mixtures shifted to dominating points.

The density is always that of the mixture drawn from, and integrates to one on the box.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from crashrate.errors import InvalidInputError
from crashrate.sampling.orthants import DominatingPoints
from crashrate.traffic.log_mixture import LogMixture
from crashrate.traffic.model import TrafficModel
from crashrate.traffic.truncated_normal import sample_truncated
from crashrate.variables import FloatArray, as_rows, frozen

# ρ of the paper: the share of f_I once there is something inside
RHO = 0.5
# "few elements": fewer minimal crashes than this, and f_I is left out
FEW_ELEMENTS = 3
# "very different": inner dominating points, on average, farther than this from an outer one, in
# standard deviations of their component
VERY_DIFFERENT = 1.0
# components with less mass than this in the box are drawn one by one, by an exact method
_REJECTION_MASS = 0.02


@dataclass(frozen=True, eq=False)
class Proposal:
    """A mixture Σ_l w_l φ(x; a_l, Σ_l) / P_l on a box, P_l being the mass of component l in it.

    Parameters
    ----------
    weights : (L,) array
        Weights of the truncated components; sum to one.
    means : (L, d) array
    covariances : (L, d, d) array
        Components may share them.
    lower, upper : (d,) arrays
        The box.
    log_masses : (L,) array
        log P_l.
    """

    weights: FloatArray
    means: FloatArray
    covariances: FloatArray
    lower: FloatArray
    upper: FloatArray
    log_masses: FloatArray
    _mixture: LogMixture = field(init=False, repr=False)

    def __post_init__(self) -> None:
        total = float(np.sum(self.weights))
        if not (np.min(self.weights) >= 0.0 and abs(total - 1.0) < 1e-9):
            raise InvalidInputError(
                f"weights: expected numbers >= 0 that sum to 1, got a sum of {total:.9g}."
            )
        for name in ("weights", "means", "covariances", "lower", "upper", "log_masses"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        object.__setattr__(self, "_mixture", self._log_mixture())

    @classmethod
    def of_traffic(cls, traffic: TrafficModel) -> "Proposal":
        """The traffic model itself."""
        return cls(
            traffic.weights,
            traffic.means,
            traffic.covariances,
            traffic.lower,
            traffic.upper,
            traffic.log_masses,
        )

    @property
    def n_components(self) -> int:
        """Number L of components."""
        return len(self.weights)

    @property
    def n_variables(self) -> int:
        """Number d of variables."""
        return int(self.means.shape[1])

    def _log_mixture(self) -> LogMixture:
        variances = np.diagonal(self.covariances, axis1=1, axis2=2)
        return LogMixture.of(
            self.weights,
            self.log_masses,
            self.means,
            self.covariances,
            shift=self.weights @ self.means,
            scale=np.sqrt(self.weights @ variances),
        )

    def log_density(self, x: npt.ArrayLike) -> FloatArray:
        """Log density (n,) of rows x (n, d); -inf outside the box.

        Raises
        ------
        InvalidInputError
            If x has another shape, or a value that is not finite.
        """
        rows = as_rows(x, self.n_variables)
        out = self._mixture.log_density(rows)
        out[~((rows >= self.lower) & (rows <= self.upper)).all(axis=1)] = -np.inf
        return out

    def sample(self, n: int, rng: np.random.Generator) -> FloatArray:
        """Independent draws (n, d), in random order.

        Raises
        ------
        InvalidInputError
            If n is negative.
        """
        if n < 0:
            raise InvalidInputError(f"n: expected a number of draws >= 0, got {n}.")
        chosen = rng.choice(self.n_components, size=n, p=self.weights)
        x = np.empty((n, self.n_variables))
        small = self.log_masses[chosen] < np.log(_REJECTION_MASS)
        x[~small] = self._rejected(chosen[~small], rng)
        for k in np.unique(chosen[small]):
            rows = chosen == k
            x[rows] = sample_truncated(
                self.means[k], self.covariances[k], self.lower, self.upper, int(rows.sum()), rng
            )
        return x

    def _rejected(self, chosen: npt.NDArray[np.intp], rng: np.random.Generator) -> FloatArray:
        """One draw of each chosen component, drawn again while outside the box."""
        factors = np.linalg.cholesky(self.covariances)
        x = np.empty((len(chosen), self.n_variables))
        left = np.arange(len(chosen))
        while len(left):
            z = rng.standard_normal((len(left), self.n_variables))
            component = chosen[left]
            x[left] = self.means[component] + np.einsum("nij,nj->ni", factors[component], z)
            left = left[~((x[left] >= self.lower) & (x[left] <= self.upper)).all(axis=1)]
        return x


def shifted(traffic: TrafficModel, points: DominatingPoints) -> Proposal | None:
    """f_I or f_O: every component moved to each of its dominating points.

    f*(x) = Σ_i Σ_{a ∈ A_i} p_i / |A_i| φ(x; a, Σ_i)  (2017 paper, §VI step 2), where φ is
    truncated to the box and p_i is the weight of the truncated component.

    Parameters
    ----------
    traffic : TrafficModel
    points : DominatingPoints
        A_I, for f_I, or A_O, for f_O.

    Returns
    -------
    Proposal or None
        None where there are no points. A component without any is left out.
    """
    if not len(points.points):
        return None
    i = points.component
    weights = traffic.weights[i] / np.bincount(i, minlength=traffic.n_components)[i]
    return Proposal(
        weights / weights.sum(),
        points.points,
        traffic.covariances[i],
        traffic.lower,
        traffic.upper,
        points.log_masses,
    )


def blend(parts: Sequence[tuple[float, Proposal]]) -> Proposal:
    """The mixture of proposals on one box, with the shares given first; they sum to one."""
    used = [(share, p) for share, p in parts if share > 0.0]
    return Proposal(
        np.concatenate([share * p.weights for share, p in used]),
        np.concatenate([p.means for _, p in used]),
        np.concatenate([p.covariances for _, p in used]),
        used[0][1].lower,
        used[0][1].upper,
        np.concatenate([p.log_masses for _, p in used]),
    )


def mixed(
    rho: float,
    inner: Proposal | None,
    outer: Proposal | None,
    traffic: TrafficModel,
    defensive_share: float,
) -> Proposal:
    """(1 - s) (ρ f_I + (1 - ρ) f_O) + s f, with f the traffic model (2017 paper, §VI step 3).

    # differs: the paper has s = 0, because its weights are unbounded: here f / q <= 1 / s.

    Parameters
    ----------
    rho : float
        Share of `inner` in the paper's mixture. Where a part is None the other one takes its
        share, and where both are, f is all there is.
    inner, outer : Proposal or None
        f_I and f_O.
    traffic : TrafficModel
    defensive_share : float
        s, in (0, 1].

    Raises
    ------
    InvalidInputError
        If rho or the share is out of its range.
    """
    if not 0.0 <= rho <= 1.0 or not 0.0 < defensive_share <= 1.0:
        raise InvalidInputError(
            "mixed: expected rho in [0, 1] and a defensive share in (0, 1], "
            f"got {rho} and {defensive_share}."
        )
    rest = 1.0 - defensive_share
    parts = [(rest * rho, inner), (rest * (1.0 - rho), outer)]
    there = [(share, p) for share, p in parts if p is not None]
    total = sum(share for share, _ in there)
    if total > 0.0:
        there = [(rest * share / total, p) for share, p in there]
    else:
        defensive_share = 1.0
    return blend([*there, (defensive_share, Proposal.of_traffic(traffic))])


def learning_rho(inner: DominatingPoints) -> float:
    """ρ while learning: ½ · 1{S_1 ≠ ∅} (2017 paper, §VI step 3)."""
    return RHO if len(inner.points) else 0.0


def recommended_rho(
    inner: DominatingPoints, outer: DominatingPoints, traffic: TrafficModel
) -> float:
    """ρ for estimating: ½ where A_I and A_O are similar, else 0 (2017 paper, end of §VI).

    The paper looks at the elements and decides; here "few elements" is fewer than `FEW_ELEMENTS`
    minimal crashes, and "very different" is a `separation` above `VERY_DIFFERENT`.
    """
    if len(np.unique(inner.orthant)) < FEW_ELEMENTS:
        return 0.0
    return RHO if separation(inner, outer, traffic) <= VERY_DIFFERENT else 0.0


def separation(inner: DominatingPoints, outer: DominatingPoints, traffic: TrafficModel) -> float:
    """How different A_I and A_O are, in standard deviations.

    The distance from an inner dominating point to the nearest outer one of the same component, in
    that component's Σ⁻¹ metric, averaged over the inner points and then over the components with
    their weights p_i; infinite where there is nothing to compare.
    """
    total, weight = 0.0, 0.0
    for i, share in enumerate(traffic.weights):
        a, b = inner.of_component(i), outer.of_component(i)
        if len(a) and len(b):
            root = np.linalg.inv(np.linalg.cholesky(traffic.covariances[i]))
            gaps = (a @ root.T)[:, None] - (b @ root.T)[None]
            total += share * float(np.sqrt((gaps**2).sum(axis=2)).min(axis=1).mean())
            weight += float(share)
    return total / weight if weight > 0.0 else np.inf
