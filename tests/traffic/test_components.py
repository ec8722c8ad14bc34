import numpy as np
import pytest

from crashrate.errors import InvalidInputError
from crashrate.traffic.components import select_components
from crashrate.traffic.model import TrafficModel


def law():
    eye = np.eye(2)
    return TrafficModel(
        [0.5, 0.5], [[0.0, 0.0], [5.0, 2.0]], [eye, 0.5 * eye], [0.0, 0.0], [np.inf] * 2, "ab"
    )


def test_the_criterion_finds_the_number_of_components():
    x = law().sample(3000, 0)
    steps = []
    chosen = select_components(
        x,
        [1, 2, 4],
        lower=[0.0, 0.0],
        random_state=0,
        on_step=lambda done, total, message: steps.append((done, total, message)),
    )
    assert chosen.candidates == (1, 2, 4)
    assert chosen.n_components == 2
    assert chosen.best.model.n_components == 2
    assert chosen.admissible == (2,)
    assert all(chosen.converged)
    # More components fit better, and pay for it: K - 1 + K d + K d (d + 1) / 2 parameters.
    assert (np.diff(chosen.log_likelihood) > 0).all()
    prices = np.log(len(x)) * np.array([5, 11, 23])
    np.testing.assert_allclose(chosen.bic, prices - 2 * chosen.log_likelihood)
    assert [step[:2] for step in steps] == [(0, 3), (1, 3), (2, 3), (3, 3)]
    assert "2 components: BIC" in steps[2][2]
    traffic = chosen.traffic_model(["speed", "gap"])
    assert traffic.provenance["selection"]["n_components"] == [1, 2, 4]
    assert TrafficModel.from_json(traffic.to_json()) == traffic


@pytest.mark.parametrize("candidates", [[], [2, 2]])
def test_candidates_must_differ(candidates):
    with pytest.raises(InvalidInputError, match="different numbers of components"):
        select_components(np.zeros((5, 1)), candidates)
