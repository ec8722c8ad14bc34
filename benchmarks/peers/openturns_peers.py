"""OpenTURNS: importance sampling at FORM's points, NAIS, cross-entropy, subset, directional.

All of them work in standard normal space, where the limit state is handed to them: there
OpenTURNS' own transformation is the identity. Samples are evaluated as a whole
(`func_sample`), which changes the time, not the count.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import openturns as ot

from peers.limit_state import Answer, LimitState
from peers.peer import Peer

Z = 1.959963984540054
Settings = Mapping[str, Any]
TEN, TWENTY = 0.1 / Z, 0.2 / Z  # coefficients of variation of ± 10 and ± 20 % at 95 %


def event(limit: LimitState, *, memory: bool = False) -> ot.ThresholdEvent:
    """{limit state ≤ 0} of independent standard normals.

    With `memory` a point that was evaluated costs nothing again.
    """
    d = limit.dimension
    function = ot.PythonFunction(d, 1, func_sample=lambda u: limit(np.asarray(u))[:, None])
    if memory:
        function = ot.MemoizeFunction(function)
    vector = ot.CompositeRandomVector(function, ot.RandomVector(ot.Normal(d)))
    return ot.ThresholdEvent(vector, ot.LessOrEqual(), 0.0)


def solver(limit: LimitState) -> ot.OptimizationAlgorithm:
    """For design points: Abdo-Rackwitz from the origin.

    SQP and Cobyla were tried on every problem and end without a point on C; SQP ends at a wrong
    point of the random walk.
    """
    algorithm = ot.AbdoRackwitz()
    algorithm.setStartingPoint([0.0] * limit.dimension)
    algorithm.setMaximumIterationNumber(200)
    algorithm.setMaximumCallsNumber(5000)
    return algorithm


def _at_design_points(
    limit: LimitState, points: Sequence[ot.FORMResult], settings: Settings, *notes: str
) -> Answer:
    """Importance sampling from unit normals at design points, in proportion to their FORM."""
    d = limit.dimension
    betas = [point.getHasoferReliabilityIndex() for point in points]
    normals = [ot.Normal(point.getStandardSpaceDesignPoint(), [1.0] * d) for point in points]
    # beyond 37 the probability is below the smallest number; a component of weight 0 is refused
    weights = [max(point.getEventProbability(), 1e-12) for point in points]
    proposal = ot.Mixture(normals, weights) if len(normals) > 1 else normals[0]
    experiment = ot.ImportanceSamplingExperiment(ot.Normal(d), proposal, settings["block"])
    algorithm = ot.ProbabilitySimulationAlgorithm(event(limit), experiment)
    algorithm.setMaximumCoefficientOfVariation(settings["coefficient_of_variation"])
    algorithm.setBlockSize(settings["block"])
    algorithm.setMaximumOuterSampling(max(1, limit.n_left // settings["block"]))
    algorithm.run()
    result = algorithm.getResult()
    reached = f"design points at {', '.join(f'{beta:.3f}' for beta in betas)}"
    return _answer(result, reached, *notes)


def _answer(result: ot.ProbabilitySimulationResult, *notes: str) -> Answer:
    half_width = Z * math.sqrt(result.getVarianceEstimate())
    return Answer.symmetric(result.getProbabilityEstimate(), half_width, *notes)


def form_is(limit: LimitState, seed: int, settings: Settings) -> Answer:
    """FORM, then importance sampling at its design point."""
    ot.RandomGenerator.SetSeed(seed)
    algorithm = ot.FORM(solver(limit), event(limit, memory=True))
    algorithm.run()
    note = f"{limit.n_calls} calls for FORM"
    return _at_design_points(limit, [algorithm.getResult()], settings, note)


def multi_form_is(limit: LimitState, seed: int, settings: Settings) -> Answer:
    """Several design points, then importance sampling from their mixture."""
    ot.RandomGenerator.SetSeed(seed)
    algorithm = ot.MultiFORM(solver(limit), event(limit, memory=True))
    algorithm.run()
    points = list(algorithm.getResult().getFORMResultCollection())
    return _at_design_points(limit, points, settings, f"{limit.n_calls} calls for FORM")


def nais(limit: LimitState, seed: int, settings: Settings) -> Answer:
    """Nonparametric adaptive importance sampling."""
    algorithm = ot.NAIS(event(limit), settings["quantile"])
    return _by_samples(algorithm, seed, limit, settings)


def cross_entropy(limit: LimitState, seed: int, settings: Settings) -> Answer:
    """Cross-entropy with one normal of free mean and deviations in standard space."""
    algorithm = ot.StandardSpaceCrossEntropyImportanceSampling(event(limit), settings["quantile"])
    return _by_samples(algorithm, seed, limit, settings)


def subset(limit: LimitState, seed: int, settings: Settings) -> Answer:
    """Subset simulation."""
    algorithm = ot.SubsetSampling(event(limit), settings["range"], settings["level"])
    return _by_samples(algorithm, seed, limit, settings)


def _by_samples(
    algorithm: ot.EventSimulation, seed: int, limit: LimitState, settings: Settings
) -> Answer:
    """The methods that take a sample of fixed size a level, in blocks."""
    ot.RandomGenerator.SetSeed(seed)
    algorithm.setBlockSize(settings["block"])
    algorithm.setMaximumOuterSampling(settings["n"] // settings["block"])
    algorithm.run()
    levels = math.ceil(limit.n_calls / settings["n"])
    return _answer(algorithm.getResult(), f"{levels} levels")


def directional(limit: LimitState, seed: int, settings: Settings) -> Answer:
    """Directional sampling: along each direction, the radii that crash."""
    ot.RandomGenerator.SetSeed(seed)
    # every root along a ray, not the first one: the disc and other bounded sets have two
    root = ot.SafeAndSlow(ot.Brent(), settings["farthest"], settings["step"])
    # not OrthogonalDirection: on D it is 30 to 60 % too high, random directions are not
    algorithm = ot.DirectionalSampling(event(limit), root, ot.RandomDirection())
    algorithm.setMaximumCoefficientOfVariation(settings["coefficient_of_variation"])
    algorithm.setMaximumOuterSampling(limit.n_left)
    algorithm.setBlockSize(settings["block"])
    algorithm.run()
    return _answer(algorithm.getResult())


# ± 10 % as ours; a block of 100 costs at most 5 % of the calls and makes an early stop on a
# coefficient of variation that is itself badly estimated rare
IS = {"coefficient_of_variation": TEN, "block": 100}
# 4,000 a level: ± 6 to 16 % in `results/calls.md` but on C and, for cross-entropy, the disc; other
# sizes were not measured
ADAPTIVE = {"n": 4000, "block": 4000, "quantile": 0.1}
# OpenTURNS' own range and level. A block is one step of every chain: with as many rows as a level
# keeps, chains are ten steps long; with one block a level they are one step long, and the answer is
# wrong by a half
SUBSET = {"n": 10_000, "block": 1000, "range": 2.0, "level": 0.1}
# ± 20 %: ± 10 % is four times the calls. Roots are looked for up to 8, where 1e-14 of the
# probability of two normals is left (d = 10: 6e-10), in steps of 1: steps of 2 pass over half of
# C's crash set, steps of 1/2 cost a half more and find no more
RAYS = {"coefficient_of_variation": TWENTY, "farthest": 8.0, "step": 1.0, "block": 20}


def _peer(
    name: str,
    run: Callable[[LimitState, int, Settings], Answer],
    settings: Settings,
    *,
    binary: bool = False,
) -> Peer:
    return Peer(f"OpenTURNS {name}", "openturns", run, settings, binary)


PEERS = (
    _peer("FORM + IS", form_is, IS),
    _peer("multi-FORM mixture IS", multi_form_is, IS),
    _peer("NAIS", nais, ADAPTIVE),
    _peer("cross-entropy", cross_entropy, ADAPTIVE),
    _peer("subset simulation", subset, SUBSET),
    _peer("directional sampling", directional, RAYS),
    _peer("directional sampling, outcomes", directional, RAYS, binary=True),
)
