"""The surrogate's kernel: chosen anew while outcomes are few, and as their number grows."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np

from crashrate.crash_set.surrogate import Prior, Sites, Surrogate
from crashrate.estimation.labels import Labels
from crashrate.estimation.refutation import DEEP
from crashrate.estimation.telling import fit_telling
from crashrate.estimation.view import Standardiser
from crashrate.variables import FloatArray

Shape = tuple[float, float, bool]


class Kernel(NamedTuple):
    """A `Prior`'s bump, its length in three coordinates (in one, if additive), its variance."""

    bump: float
    length: float
    variance: float
    additive: bool = False

    @property
    def shape(self) -> "Shape":
        """All but the variance."""
        return self.bump, self.length, self.additive


SHAPES = ((0.1, 3.0), (0.5, 2.0), (1.0, 1.0), (3.0, 1.0))
KERNELS = tuple(Kernel(*shape, variance) for shape in SHAPES for variance in (1e3, 1e4))
ADDITIVE = tuple(Kernel(3.0, 2.0, variance, additive=True) for variance in (1e3, 1e4))
# An additive kernel supposes more than the others: its score must be better by so much (a factor of
# fifty), or it is chosen by chance while labels are few.
SUPPOSES_MORE = 4.0
LINEAR, FAR_SAFE = 0.01, -5.0  # without an order
# … and soft ones, where equal situations may end differently: how likely a crash is falls off along
# a plane, and nothing is certain far away
SOFT = tuple(Kernel(0.1, 3.0, variance) for variance in (10.0, 100.0))
N_RIVALS = 2
# Choose among all kernels below so many labels, and whenever they have grown so far; of MANY each
# fit takes seconds, and they hardly change the choice.
REFIT_ALWAYS, REFIT_GROWTH, MANY, GROWTH_OF_MANY = 120, 1.15, 700, 1.5


@dataclass(frozen=True)
class Model:
    """The surrogate's standing.

    Parameters
    ----------
    standardise : Standardiser
        Its coordinates.
    best : Kernel
        The kernel in use.
    n_chosen : int
        Labels when the kernel was last chosen.
    warm : tuple
        The sites of each kernel's last fit, of all labels.
    """

    standardise: Standardiser
    best: Kernel = KERNELS[0]
    n_chosen: int = 0
    warm: tuple[tuple[Kernel, Sites], ...] = ()

    def forgetting(self) -> Self:
        """Without sites: the labels they belong to changed."""
        return replace(self, warm=(), n_chosen=0)

    def fit(
        self, labels: Labels, ordinary: FloatArray, *, directed: bool, again: bool = False
    ) -> tuple[Surrogate, Self]:
        """The surrogate of these outcomes, by the kernel of the best leave-one-out score.

        `ordinary` (n, m) counts as safe; `directed`: danger grows along the coordinates; `again`:
        the kernel is chosen anew however few labels came since.
        """
        growth = REFIT_GROWTH if labels.n < MANY else GROWTH_OF_MANY
        grown = labels.n >= growth * self.n_chosen
        choose = again or grown or labels.n < REFIT_ALWAYS
        kernels = self._candidates(labels, directed=directed) if choose else (self.best,)
        fits = self._fits(labels, ordinary, kernels, directed=directed)
        best = max(fits, key=lambda kernel: _merit(fits[kernel][0], soft=SOFT[0] in fits))
        warm = dict(self.warm) | {kernel: sites for kernel, (_, sites) in fits.items()}
        n_chosen = labels.n if choose else self.n_chosen
        return fits[best][0], replace(self, best=best, n_chosen=n_chosen, warm=tuple(warm.items()))

    def rivals(
        self, labels: Labels, ordinary: FloatArray, *, directed: bool
    ) -> tuple[Surrogate, ...]:
        """The best surrogates by kernels of other shapes than the one in use, the best first."""
        kernels = [
            kernel
            for kernel in self._candidates(labels, directed=directed)
            if kernel.shape != self.best.shape
        ]
        fits = self._fits(labels, ordinary, kernels, directed=directed)
        best: dict[Shape, Surrogate] = {}
        for kernel, (fit, _) in fits.items():
            other = best.setdefault(kernel.shape, fit)
            best[kernel.shape] = max(fit, other, key=lambda f: f.log_score)
        return tuple(sorted(best.values(), key=lambda f: -f.log_score)[:N_RIVALS])

    def _fits(
        self,
        labels: Labels,
        ordinary: FloatArray,
        kernels: Sequence[Kernel],
        *,
        directed: bool,
    ) -> dict[Kernel, tuple[Surrogate, Sites]]:
        known, warm, d = labels.known, dict(self.warm), labels.u.shape[1]
        u = self.standardise(np.concatenate([ordinary, labels.u[known]]))
        crash = np.concatenate([np.zeros(len(ordinary), bool), labels.y[known] == 1])
        return {
            kernel: fit_telling(
                u,
                crash,
                _prior(kernel, d, directed=directed),
                warm.get(kernel, Sites.unknown(0)).grown(len(u)),
            )
            for kernel in kernels
        }

    def _candidates(self, labels: Labels, *, directed: bool) -> tuple[Kernel, ...]:
        """Sharp kernels, and soft ones, which learn slowly, where outcomes deny an order deeply."""
        sharp = KERNELS + ADDITIVE if labels.u.shape[1] > 1 else KERNELS
        if labels.learned is None:
            soft = labels.order is None or not directed
        else:
            soft = labels.contradiction_gaps(self.standardise.unit).max(initial=0.0) > DEEP
        return sharp + SOFT if soft else sharp


def _merit(fit: Surrogate, *, soft: bool) -> tuple[bool, float]:
    """What the kernels are compared by.

    Where outcomes contradict an order deeply, inference that did not converge is no candidate: its
    score is what it happened to oscillate through. (At ripples it oscillates too, and is of use.)
    """
    return fit.converged or not soft, fit.log_score - SUPPOSES_MORE * fit.prior.additive


def _prior(kernel: Kernel, d: int, *, directed: bool) -> Prior:
    bump, length, variance, additive = kernel
    length *= 1.0 if additive else math.sqrt(d / 3)
    if directed or kernel in SOFT:
        slope = 1.0 if directed else 0.0
        return Prior(bump, length, variance, 1.0, slope=slope, constant=0.0, additive=additive)
    # without an order no direction is riskier, and far from any crash is safe
    return Prior(bump, length, variance, LINEAR, slope=0.0, constant=FAR_SAFE, additive=additive)
