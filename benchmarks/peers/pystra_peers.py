"""pystra: FORM and importance sampling at its design point.

Its active learning with Kriging belongs to a version 2.0 that is not released; `kriging.py` has
the method.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pystra

from peers.limit_state import Answer, LimitState
from peers.peer import Peer

Z = 1.959963984540054


def form_is(limit: LimitState, seed: int, settings: Mapping[str, Any]) -> Answer:
    """FORM, then importance sampling from a unit normal at its design point."""
    np.random.seed(seed)  # noqa: NPY002 -- pystra draws from NumPy's global generator
    analysis = pystra.ImportanceSampling(
        analysis_options=_options(limit, settings),
        limit_state=pystra.LimitState(lambda **u: limit(np.column_stack(list(u.values())))),
        stochastic_model=_standard_normals(limit.dimension),
    )
    note = f"{limit.n_calls} calls for FORM"  # the constructor runs it
    analysis.run()
    probability, variation = analysis.getFailure(), analysis.cov_q_bar[analysis.k - 1]
    return Answer.symmetric(float(probability), float(Z * variation * probability), note)


def _options(limit: LimitState, settings: Mapping[str, Any]) -> pystra.AnalysisOptions:
    options = pystra.AnalysisOptions()
    options.setPrintOutput(False)
    options.setImax(settings["iterations"])
    options.setBlockSize(settings["block"])
    options.setSamples(limit.n_left)
    options.target_cov = settings["coefficient_of_variation"]  # it has no setter
    return options


def _standard_normals(d: int) -> pystra.StochasticModel:
    model = pystra.StochasticModel()
    for i in range(d):
        model.addVariable(pystra.Normal(f"u{i + 1:02d}", 0.0, 1.0))
    return model


SETTINGS = {
    "coefficient_of_variation": 0.1 / Z,  # ± 10 % at 95 %, as ours
    "block": 100,  # as for OpenTURNS: at most 5 % of the calls beyond the target
    "iterations": 100,  # pystra's own
}
PEERS = (Peer("pystra FORM + IS", "pystra", form_is, SETTINGS),)
