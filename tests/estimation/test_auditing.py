"""The audit's limits hold as often as they say, against exact shares."""

import numpy as np
import pytest
from scipy.stats import norm

from crashrate.crash_set.order import RiskOrder
from crashrate.estimation import auditing
from crashrate.estimation.auditing import LAYER, _layer, audit_order
from crashrate.estimation.exploration import inflated
from crashrate.estimation.gap import Gap
from crashrate.estimation.labels import Labels
from crashrate.estimation.order_audit import OrderAudit
from crashrate.estimation.strategy import Problem, Snapshot
from crashrate.sampling.pool import draw_pool

SEEDS = range(120)
# one crash at (2, 2) implies {a, b >= 2}; of it {a > WRONG} is safe after all
WRONG = 2.6
SHARE = norm.sf(WRONG) / norm.sf(2.0)


@pytest.fixture(scope="module")
def audits(request):
    cases = request.getfixturevalue("cases")
    drive = request.getfixturevalue("drive")
    traffic = cases.standard_normal(2)
    order = RiskOrder.from_mapping(cases.increasing(2), traffic.names)
    problem = Problem(traffic=traffic, order=order)
    labels = Labels.empty(problem).add(np.array([[2.0, 2.0], [1.9, 1.9]]), np.array([1.0, 0.0]))

    def simulate(x):
        return ((x >= 2).all(axis=1) & (x[:, 0] <= WRONG)).astype(float)

    def audit(seed):
        steps = audit_order(
            problem,
            inflated(traffic, (1.0, 4.0)),
            labels,
            np.ones(2),
            24,
            rng=np.random.default_rng(seed),
            snapshot=Snapshot(),
        )
        return drive(steps, simulate)[0][1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(auditing, "N_POOL", 1500)
        return [audit(seed) for seed in SEEDS]


def test_draws_are_those_of_traffic(audits, check_mean):
    check_mean([a.n_crash_wrong / a.n_crash for a in audits], SHARE)


def test_the_limit_holds_as_often_as_it_says(audits):
    held = sum(a.crash_share >= SHARE for a in audits)
    assert held >= 0.93 * len(audits)  # 97.5 %, and chance
    # the share that was seen is no such limit
    assert sum(a.n_crash_wrong / a.n_crash >= SHARE for a in audits) < 0.85 * len(audits)


def test_safe_draws_are_right_and_bounded(audits):
    for a in audits[:10]:
        assert (a.n_safe, a.n_safe_wrong) == (12, 0)
        assert a.safe_share == pytest.approx(1 - 0.025 ** (1 / 12))


def test_the_layer_is_next_to_the_outer_set_and_carries_its_multiple(cases):
    traffic = cases.standard_normal(2)
    order = RiskOrder.from_mapping(cases.increasing(2), traffic.names)
    problem = Problem(traffic=traffic, order=order)
    # everything with a < 3 or so is safe: the layer is a strip below it
    labels = Labels.empty(problem).add(np.array([[3.0, 50.0]]), np.zeros(1))
    rng = np.random.default_rng(0)
    pool = draw_pool(inflated(traffic, (1.0, 4.0)), traffic, labels.coordinates, 60_000, rng)
    gap = Gap.of(pool, labels)
    rows = _layer(gap, labels, np.array([1.0, 1e-3]))
    below = norm.isf((1 + LAYER) * norm.sf(3.0))
    assert gap.weights[rows].sum() == pytest.approx(LAYER * norm.sf(3.0), rel=0.1)
    assert pool.x[rows, 0].min() == pytest.approx(below, abs=0.03)
    assert pool.x[rows, 0].max() <= 3.0


def test_what_it_leaves_and_says():
    audit = OrderAudit(20, 1, 0.25, 20, 0, 0.17, 3e-6, 0.95)
    assert audit.least((8e-7, 1e-6)) == pytest.approx(6e-7)
    assert audit.crash_mass_missed == pytest.approx(5.1e-7)
    text = audit.sentence((8e-7, 1e-6))
    assert "of 20 runs implied to crash 1 did not" in text
    assert "p ≥ 6.0e-07 whatever the order" in text
    assert audit.to_dict((8e-7, 1e-6))["sentence"] == text
