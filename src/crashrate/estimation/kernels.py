"""The surrogate's kernel: chosen anew while outcomes are few, and as their number grows."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from crashrate.crash_set.surrogate import Prior, Sites, Surrogate, fit_surrogate
from crashrate.estimation.labels import Labels
from crashrate.estimation.view import Standardiser
from crashrate.variables import FloatArray

KERNELS = tuple(
    (bump, length, variance)
    for bump, length in ((0.1, 3.0), (0.5, 2.0), (1.0, 1.0), (3.0, 1.0))
    for variance in (1e3, 1e4)
)
Kernel = tuple[float, float, float]
REFIT_ALWAYS, REFIT_GROWTH = 120, 1.15  # choose among all kernels below, and on growth, of labels


@dataclass(frozen=True)
class Model:
    """The surrogate's standing.

    Parameters
    ----------
    standardise : Standardiser
        Its coordinates.
    best : tuple of float
        The kernel in use.
    n_chosen : int
        Labels when the kernel was last chosen.
    warm : tuple
        The sites of each kernel's last fit.
    """

    standardise: Standardiser
    best: Kernel = KERNELS[0]
    n_chosen: int = 0
    warm: tuple[tuple[Kernel, Sites], ...] = ()

    def forgetting(self) -> Self:
        """Without sites: the labels they belong to changed."""
        return replace(self, warm=(), n_chosen=0)

    def fit(
        self, labels: Labels, ordinary: FloatArray, *, directed: bool
    ) -> tuple[Surrogate, Self]:
        """The surrogate of these outcomes, by the kernel of the best leave-one-out score.

        `ordinary` (n, m) counts as safe; `directed`: danger grows along the coordinates.
        """
        known = labels.known
        u = self.standardise(np.concatenate([ordinary, labels.u[known]]))
        crash = np.concatenate([np.zeros(len(ordinary), bool), labels.y[known] == 1])
        choose = labels.n < REFIT_ALWAYS or labels.n >= REFIT_GROWTH * self.n_chosen
        warm, d = dict(self.warm), labels.u.shape[1]
        fits = {
            kernel: fit_surrogate(u, crash, _prior(kernel, d, directed=directed), warm.get(kernel))
            for kernel in (KERNELS if choose else (self.best,))
        }
        best = max(fits, key=lambda kernel: fits[kernel].log_score)
        warm |= {kernel: fit.sites for kernel, fit in fits.items()}
        n_chosen = labels.n if choose else self.n_chosen
        return fits[best], replace(self, best=best, n_chosen=n_chosen, warm=tuple(warm.items()))


def _prior(kernel: Kernel, d: int, *, directed: bool) -> Prior:
    bump, length, variance = kernel
    length *= np.sqrt(d / 3)
    if directed:
        return Prior(bump, length, variance, linear=1.0, slope=1.0, constant=0.0)
    # without an order no direction is riskier, and far from any crash is safe
    return Prior(bump, length, variance, linear=0.01, slope=0.0, constant=-4.0)
