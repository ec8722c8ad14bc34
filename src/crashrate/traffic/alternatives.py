"""Other laws of traffic, by name, for comparison only.

Both are in use in the field, and both say little about the corner where crashes are: what they make
of the same recordings is shown beside the joint model, with the same checks.
"""

from dataclasses import dataclass

import numpy as np

from crashrate.traffic.margins import Margin
from crashrate.variables import BoolArray, FloatArray, frozen

INDEPENDENT = "independent marginals"
COPULA = "Pareto margins, Gaussian copula"
SHRINK = 1 - 1e-6  # of correlations: a matrix that inverts where a variable repeats another


@dataclass(frozen=True, eq=False)
class CopulaLaw:
    """Margins joined by a Gaussian copula; independent where its correlation is the identity.

    Rows are on the modelled scales.

    Parameters
    ----------
    name : str
    margins : tuple of Margin, length d
    correlation : ndarray (d, d)
        Of the margins' normal scores.
    """

    name: str
    margins: tuple[Margin, ...]
    correlation: FloatArray

    @property
    def independent(self) -> bool:
        """Whether the variables know nothing of each other."""
        return bool((self.correlation == np.eye(len(self.margins))).all())

    @property
    def n_parameters(self) -> int:
        """Free parameters, for the Bayesian information criterion."""
        d = len(self.margins)
        own = 0 if self.independent else d * (d - 1) // 2
        return own + sum(margin.n_parameters for margin in self.margins)

    def contains(self, z: FloatArray) -> BoolArray:
        """Which rows (n, d) lie between all sides: (n,)."""
        sides = [(m.body.lower[0], m.body.upper[0]) for m in self.margins]
        low, high = np.array(sides).T
        return np.asarray(((z >= low) & (z <= high)).all(axis=1))

    def log_density(self, z: FloatArray) -> FloatArray:
        """Log density (n,) of rows (n, d); -inf outside."""
        columns = list(zip(self.margins, z.T, strict=True))
        total = np.sum([margin.log_density(column) for margin, column in columns], axis=0)
        if self.independent:
            return np.asarray(total)
        scores = np.stack([margin.normal_scores(column) for margin, column in columns], axis=1)
        curved = np.linalg.inv(self.correlation) - np.eye(len(columns))
        quadratic = np.einsum("ni,ij,nj->n", scores, curved, scores)
        return np.asarray(total - 0.5 * (quadratic + np.linalg.slogdet(self.correlation)[1]))

    def sample(self, n: int, rng: np.random.Generator) -> FloatArray:
        """Independent draws (n, d)."""
        d = len(self.margins)
        scores = rng.standard_normal((n, d)) @ np.linalg.cholesky(self.correlation).T
        columns = zip(self.margins, scores.T, strict=True)
        return np.stack([margin.of_scores(column) for margin, column in columns], axis=1)


def alternatives(z: FloatArray, lower: FloatArray, upper: FloatArray) -> tuple[CopulaLaw, ...]:
    """The laws fitted to events z (n, d) between sides (d,), all on the modelled scales.

    "independent marginals": every variable a mixture of its own, none knowing of another.
    "Pareto margins, Gaussian copula": generalised Pareto tails where a variable is unbounded above,
    and the correlation of the normal scores.
    """
    sides = zip(z.T, lower, upper, strict=True)
    bodies = tuple(Margin.of(column, float(low), float(high)) for column, low, high in sides)
    tailed = tuple(m.with_tail(column) for m, column in zip(bodies, z.T, strict=True))
    scores = np.stack([m.normal_scores(c) for m, c in zip(tailed, z.T, strict=True)], axis=1)
    correlation = SHRINK * np.atleast_2d(np.corrcoef(scores.T))
    np.fill_diagonal(correlation, 1.0)
    return (
        CopulaLaw(INDEPENDENT, bodies, frozen(np.eye(z.shape[1]))),
        CopulaLaw(COPULA, tailed, frozen(correlation)),
    )
