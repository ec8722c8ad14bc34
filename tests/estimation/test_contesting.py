"""Where a rival kernel sees crashes that the surrogate is sure are none."""

import numpy as np
import pytest

from crashrate.crash_set.surrogate import fit_surrogate
from crashrate.estimation.contesting import SURE, contested
from crashrate.estimation.exploration import inflated

pytestmark = pytest.mark.usefixtures("small")
N = 12


@pytest.fixture
def finished(cases):
    campaign = cases.half_plane(1e-4, d=3).campaign(max_calls=90, relative_half_width=0.01)
    while not campaign.done:
        x = campaign.ask()
        campaign.tell(x.sum(axis=1) >= np.sqrt(3) * 3.719)
    return campaign


def silent(problem, belief, rng):
    """Situations that nothing decides and the surrogate is sure are safe, the likeliest first."""
    x = inflated(problem.traffic, (4.0,)).sample(20_000, rng)
    decided = np.logical_or(*belief.labels.presumed(belief.labels.coordinates(x)))
    x = x[~decided & (belief.see(x).surrogate_h < SURE / 10)]
    return x[np.argsort(-problem.traffic.log_density(x))]


def rival_that_saw(belief, place):
    """A surrogate of the same outcomes and one crash more, at `place` (d,)."""
    labels = belief.labels
    u = np.concatenate([labels.u, labels.coordinates(place[None])])
    crash = np.append(labels.y == 1, True)
    return fit_surrogate(belief.standardise(u), crash, belief.surrogate.prior)


def sees(belief, rival, x):
    return rival.predict(belief.standardise(belief.labels.coordinates(x))).probability


def test_draws_are_where_the_rival_sees_crashes_and_the_surrogate_none(finished):
    problem, belief = finished.problem, finished.snapshot.belief
    place = silent(problem, belief, np.random.default_rng(0))[0]
    rival = rival_that_saw(belief, place)
    x = contested(problem, belief, [rival], N, np.random.default_rng(1))
    assert 1 < len(x) <= N
    assert (belief.see(x).surrogate_h < SURE).all()
    assert not np.logical_or(*belief.labels.presumed(belief.labels.coordinates(x))).any()
    elsewhere = silent(problem, belief, np.random.default_rng(2))
    assert sees(belief, rival, x).mean() > max(0.1, 5 * sees(belief, rival, elsewhere).mean())


def test_each_rival_has_its_part(finished):
    problem, belief = finished.problem, finished.snapshot.belief
    places = silent(problem, belief, np.random.default_rng(0))[[0, 200]]
    rivals = [rival_that_saw(belief, place) for place in places]
    x = contested(problem, belief, rivals, N, np.random.default_rng(2))
    first, second = (sees(belief, rival, x) for rival in rivals)
    assert (first > second).any()
    assert (second > first).any()
    none = contested(problem, belief, rivals, 0, np.random.default_rng(2))
    assert none.shape == (0, 3)
    assert contested(problem, belief, [], N, np.random.default_rng(2)).shape == (0, 3)
