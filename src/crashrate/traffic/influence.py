"""Influence of single events on what a fit says: the infinitesimal jackknife.

An event counted 1 + e times moves the fit by e times the inverse information times the event's
score, and with it any number computed from the fit (Jaeckel 1972; Giordano et al. 2019). The
information is the exact one of the mixture (Louis 1982), so nothing is refitted.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from crashrate.traffic import quadratic
from crashrate.traffic.model import TrafficModel
from crashrate.traffic.natural import to_natural
from crashrate.traffic.standard import Standard
from crashrate.traffic.truncated_components import Components, components_at
from crashrate.variables import FloatArray

# Least curvature, over that of complete data (labels known): the likelihood is flat beyond it.
LEAST_CURVATURE = 1e-7


@dataclass(frozen=True, eq=False)
class FittedMixture:
    """A fitted mixture with the coordinates of its fit.

    Parameters
    ----------
    model : TrafficModel
        Every scale linear.
    standard : Standard
        Of the events.
    components : Components
        In standard coordinates.
    prior_strength : float
        Pseudo-events per component.
    """

    model: TrafficModel
    standard: Standard
    components: Components
    prior_strength: float

    @classmethod
    def of(cls, model: TrafficModel, events: FloatArray, prior_strength: float) -> "FittedMixture":
        """The fit of `model` to events (n, d), both on the modelled scales."""
        standard = Standard.of(events, model.lower, model.upper)
        theta = to_natural(
            standard.forward(model.means), standard.forward_covariances(model.covariances)
        )
        return cls(model, standard, components_at(theta, standard.box), prior_strength)

    @property
    def _offset(self) -> FloatArray:
        """What every score has less: (K, 1 + q), the weights in the first column."""
        offset = np.zeros((self.model.n_components, 1 + self.components.theta.shape[1]))
        offset[:, 0] = self.model.weights
        return offset.ravel()

    def _parts(self, rows: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
        """By blocks: shares r (n, K) of the components, and (1, s(y) - E_k s) (n, K, 1 + q)."""
        factors = quadratic.pair_factors(rows.shape[1])
        for block in quadratic.blocks(len(rows)):
            features = quadratic.features(self.standard.forward(rows[block])).T
            features[:, 1 + rows.shape[1] :] *= factors
            centred = np.repeat(features[:, None], self.model.n_components, axis=1)
            centred[:, :, 1:] -= self.components.expected
            yield self.model.component_probabilities(rows[block]), centred

    def scores(self, rows: FloatArray) -> Iterator[FloatArray]:
        """By blocks: gradient (n, K (1 + q)) of the log density in log weights and theta."""
        for r, centred in self._parts(rows):
            yield (r[:, :, None] * centred).reshape(len(r), -1) - self._offset

    def information(self, events: FloatArray) -> FloatArray:
        """Minus the Hessian of the penalised log likelihood, its gauge direction made definite.

        Louis (1982): complete-data information, less the covariance of the complete-data scores
        over the labels.
        """
        k, q = self.components.theta.shape
        labels = np.zeros((k, 1 + q, 1 + q))
        between = np.zeros((k * (1 + q),) * 2)
        counts = np.zeros(k)
        for r, centred in self._parts(events):
            weighted = r[:, :, None] * centred
            labels += np.einsum("nka,nkb->kab", weighted, centred, optimize=True)
            flat = weighted.reshape(len(r), -1)
            between += flat.T @ flat
            counts += r.sum(axis=0)
        between += self._complete(counts, len(events))
        for j in range(k):
            own = slice(j * (1 + q), (j + 1) * (1 + q))
            between[own, own] -= labels[j]
        return between

    def _complete(self, counts: FloatArray, n: int) -> FloatArray:
        """Complete-data information, prior and gauge included."""
        k, q = self.components.theta.shape
        out = np.zeros((k, 1 + q, k, 1 + q))
        w, parts = self.model.weights, self.components
        # log weights move only up to a constant: n w w' would be taken off, and comes back as gauge
        out[range(k), 0, range(k), 0] = n * w
        prior = self.prior_strength * parts.prior_information
        blocks = counts[:, None, None] * parts.information + prior
        out[range(k), 1:, range(k), 1:] = blocks
        return out.reshape(k * (1 + q), k * (1 + q))


@dataclass(frozen=True, eq=False)
class Influence:
    """How each event moves a number that a fit gives.

    Parameters
    ----------
    per_event : ndarray (n,)
        Change of the number if the event were counted once more, to first order.
    n_flat : int
        Directions in which the likelihood is flat to rounding: their part is left out.
    """

    per_event: FloatArray
    n_flat: int

    @property
    def standard_error(self) -> float:
        """Of the number, by the infinitesimal jackknife: what the events leave open at this fit."""
        return float(np.sqrt(self.per_event @ self.per_event))

    def most(self, n: int) -> np.ndarray:
        """Indices of the n events with most influence, most first."""
        return np.argsort(-np.abs(self.per_event), kind="stable")[:n]

    def variance_share(self, n: int) -> float:
        """Share of the jackknife variance that the n events with most influence carry."""
        squares = np.sort(self.per_event**2)[::-1]
        total = squares.sum()
        return float(squares[:n].sum() / total) if total > 0 else 0.0


def influence(
    fit: FittedMixture, events: FloatArray, x: FloatArray, weights: FloatArray
) -> Influence:
    """Influence of every event on a probability under the fit.

    Parameters
    ----------
    fit : FittedMixture
    events : ndarray (n, d)
        On the modelled scales, as all rows here.
    x, weights : ndarray (m, d), (m,)
        Draws whose weights sum to the probability.
    """
    blocks = zip(quadratic.blocks(len(x)), fit.scores(x), strict=True)
    gradient = np.sum([weights[block] @ scores for block, scores in blocks], axis=0)
    direction, n_flat = _solve(fit.information(events), gradient)
    moved = [scores @ direction for scores in fit.scores(events)]
    return Influence(np.concatenate(moved), n_flat)


def _solve(information: FloatArray, gradient: FloatArray) -> tuple[FloatArray, int]:
    """Inverse information times gradient, without the directions that are flat to rounding."""
    size = np.sqrt(np.maximum(np.diagonal(information), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(information / np.outer(size, size))
    flat = values < LEAST_CURVATURE
    inverse = np.where(flat, 0.0, 1.0 / np.where(flat, 1.0, values))
    direction = vectors @ (inverse * (vectors.T @ (gradient / size))) / size
    return np.asarray(direction), int(flat.sum())
