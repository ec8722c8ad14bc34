import json

import numpy as np
import pytest

from crashrate.errors import InvalidInputError, NumericalError
from crashrate.traffic import ensemble
from crashrate.traffic.components import _start_seed, _tasks, select_components
from crashrate.traffic.model import TrafficModel


def law():
    eye = np.eye(2)
    return TrafficModel(
        [0.5, 0.5], [[0.0, 0.0], [5.0, 2.0]], [eye, 0.5 * eye], [0.0, 0.0], [np.inf] * 2, ["a", "b"]
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


@pytest.fixture
def failing(monkeypatch):
    """Fits of the numbers of components given, from all but so many first starts, fail."""

    def fail(*numbers, but=0):
        real, sound = ensemble._fit, {_start_seed(0, k, r) for k in numbers for r in range(but)}

        def fit(task, rows, parameters):
            if task.n_components in numbers and task.seed not in sound:
                raise NumericalError(f"collapsed with {task.n_components}")
            return real(task, rows, parameters)

        monkeypatch.setattr(ensemble, "_fit", fit)

    return fail


def test_a_start_that_fails_is_survived_and_counted(failing):
    failing(2, but=1)
    with pytest.warns(UserWarning, match=r"1 of 4 fits failed \(1 of 2 components\)") as told:
        chosen = select_components(law().sample(300, 0), [1, 2], n_restarts=2, lower=0.0)
    assert len(told) == 1
    assert chosen.candidates == (1, 2)
    assert chosen.n_failed == (0, 1)
    assert np.isnan(chosen.bic_restarts).tolist() == [[False, False], [False, True]]
    assert chosen.spread >= 10
    curve = json.loads(chosen.traffic_model().to_json())["provenance"]["selection"]
    assert curve["n_failed"] == [0, 1]
    assert curve["bic_restarts"][1][1] is curve["held_out"][1][1] is None


def test_a_number_whose_every_start_fails_is_left_out(failing):
    failing(2)
    with pytest.warns(UserWarning, match=r"2 of 6 fits failed \(2 of 2 components\)"):
        chosen = select_components(law().sample(300, 0), [1, 2, 3], n_restarts=2, lower=0.0)
    assert chosen.candidates == (1, 3)
    assert chosen.left_out == (2,)
    assert chosen.held_out.shape == (2, 2)
    assert chosen.traffic_model().provenance["selection"]["left_out"] == [2]


def test_where_every_start_fails_the_reason_is_raised(failing):
    failing(1, 2)
    with pytest.raises(NumericalError, match="collapsed with 1"):
        select_components(law().sample(300, 0), [1, 2], n_restarts=2, lower=0.0)


def test_the_selection_does_not_depend_on_the_number_of_workers():
    x = law().sample(300, 0)
    alone, together = (
        select_components(x, [1, 2], n_restarts=2, workers=n, lower=0.0) for n in (1, 2)
    )
    assert np.isfinite(alone.held_out).all()
    assert alone.traffic_model() == together.traffic_model()


def test_starts_of_one_number_differ_and_splits_do_so_by_start_alone():
    tasks = _tasks((2, 3), 2, 0)
    assert len({(t.n_components, t.seed) for t in tasks}) == 4
    assert tasks[0].held_out == tasks[2].held_out != tasks[1].held_out == tasks[3].held_out
