import dataclasses
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from crashrate.crash_set.order import RiskOrder
from crashrate.errors import InvalidInputError
from crashrate.estimation.alarms import Alarm, StopReason
from crashrate.estimation.campaign import Campaign
from crashrate.estimation.huang2017 import (
    Huang2017Settings,
    Huang2017Snapshot,
    _audit_chances,
    huang2017,
)
from crashrate.estimation.labels import Labels
from crashrate.estimation.settling import Settled
from crashrate.estimation.strategy import Problem
from crashrate.sampling import proposals
from crashrate.traffic.model import TrafficModel

NAMES = ("a", "b")
UP = {"a": "increasing", "b": "increasing"}
SMALL = Huang2017Settings(n_per_iteration=60, max_iterations=6, n_per_block=500)


def half_plane(x):
    return x.sum(axis=1) >= 5.0


P_HALF_PLANE = float(norm.sf(5 / math.sqrt(2)))


def problem(risk=UP, **changes):
    traffic = TrafficModel([1.0], [np.zeros(2)], [np.eye(2)], [-np.inf] * 2, [np.inf] * 2, NAMES)
    order = None if risk is None else RiskOrder.from_mapping(risk, NAMES)
    return Problem(**{"traffic": traffic, "order": order, "relative_half_width": 0.25} | changes)


def run(p, crashes=half_plane, settings=SMALL):
    """The last snapshot, all queries, all outcomes."""
    steps, queries, outcomes = huang2017(p, settings), [], []
    try:
        queries.append(next(steps))
        while True:
            outcomes.append(np.asarray(crashes(queries[-1].x), float))
            queries.append(steps.send(outcomes[-1]))
    except StopIteration as end:
        return end.value, queries, outcomes


@pytest.fixture(scope="module")
def finished():
    return run(problem())


N_SEEDS = 6
EARLY = Huang2017Settings(n_per_iteration=60, max_iterations=3, n_per_block=4000)


def scores(monkeypatch, rho):
    """(estimate - p) / standard error of several seeds: standard normal where all is right."""
    monkeypatch.setattr("crashrate.estimation.huang2017.recommended_rho", lambda *_: rho)
    runs = (problem(seed=s, relative_half_width=0.08) for s in range(N_SEEDS))
    last = [run(p, settings=EARLY)[0] for p in runs]
    assert {s.rho for s in last} == {rho}
    return np.array([(s.probability - P_HALF_PLANE) / s.standard_error for s in last])


@pytest.mark.parametrize("rho", [0.0, 0.5])
def test_unbiased_with_honest_errors_over_several_seeds(rho, monkeypatch):
    z = scores(monkeypatch, rho)
    assert abs(z.mean()) < 3.5 / math.sqrt(N_SEEDS)
    assert z.std() < 2


def test_the_density_that_ignores_rho_is_noticed(monkeypatch):
    """Negative control: draws of ρ f_I + (1-ρ) f_O weighted as if they came from f_O."""

    @dataclasses.dataclass(frozen=True, eq=False)
    class Wrong(proposals.Proposal):
        claimed: proposals.Proposal = None

        def log_density(self, x):
            return self.claimed.log_density(x)

    def mixed(rho, inner, outer, traffic, share):
        drawn, claimed = (proposals.mixed(r, inner, outer, traffic, share) for r in (rho, 0.0))
        values = {f.name: getattr(drawn, f.name) for f in dataclasses.fields(drawn) if f.init}
        return Wrong(**values, claimed=claimed)

    monkeypatch.setattr("crashrate.estimation.huang2017.mixed", mixed)
    z = scores(monkeypatch, 0.5)
    assert abs(z.mean()) > 3.5 / math.sqrt(N_SEEDS)
    assert z.std() > 2


def test_a_finished_run_holds_the_answer(finished):
    last, _, outcomes = finished
    assert last.stop_reason is StopReason.TARGET_MET
    assert last.interval[0] < P_HALF_PLANE < last.interval[1]
    assert last.bounds[0] < P_HALF_PLANE < last.bounds[1]
    assert last.rho == 0.5
    assert last.n_draws > 3 * sum(map(len, outcomes))
    assert 1 < last.log_efficiency < 2
    assert last.n_eff >= 10
    assert last.alarms == ()


def test_no_draw_is_asked_for_that_the_order_decides(finished):
    """But for audits: a small share."""
    _, queries, outcomes = finished
    decided = [
        (q.snapshot.learned.classify(q.x) != -1) if k else np.zeros(len(q.x), bool)
        for k, q in enumerate(queries)
    ]
    # a query's snapshot is that of its block: compare with what was known when it was asked
    assert len(outcomes) == len(queries)
    assert np.concatenate(decided).mean() < 0.1


def test_snapshots_show_the_procedure_at_work(finished):
    last, queries, _ = finished
    snapshots = [q.snapshot for q in queries] + [last]
    assert all(isinstance(s, Huang2017Snapshot) for s in snapshots)
    iterations = [s.iteration for s in snapshots]
    assert iterations == sorted(iterations)
    assert snapshots[0].inner is None
    assert snapshots[0].rho == 0.0
    assert math.isnan(snapshots[0].probability)
    assert snapshots[0].interval == (0.0, 1.0)
    np.testing.assert_array_equal(last.inner.apexes.shape[1], 2)
    assert {s.phase for s in snapshots} >= {"learn 0", "learn 1", "estimate"}
    widths = [s.bounds[1] - s.bounds[0] for s in snapshots]
    assert np.all(np.diff(widths) <= 1e-12)


def test_the_first_draws_are_ordinary_traffic():
    p = problem(seed=3)
    first = next(huang2017(p, SMALL)).x
    expected = proposals.Proposal.of_traffic(p.traffic).sample(60, p.rng(0))
    assert all((expected == row).all(axis=1).any() for row in first)


@pytest.mark.parametrize(
    ("settings", "n_iterations"),
    [
        (replace(SMALL, max_iterations=2, max_elements=1000), 2),
        (replace(SMALL, max_iterations=50, max_elements=1), 1),
        (replace(SMALL, max_iterations=50, max_elements=1000, max_corners=2), 1),
        (replace(SMALL, max_iterations=50, max_elements=1000, learning_share=0.001), 1),
    ],
)
def test_stopping_rules_of_the_iteration(settings, n_iterations):
    last, _, _ = run(problem(relative_half_width=1.0), settings=settings)
    assert last.iteration == n_iterations


@pytest.mark.parametrize("max_calls", [1, 7, 40, 111])
def test_the_budget_is_kept_whatever_it_is(max_calls):
    last, _, outcomes = run(problem(max_calls=max_calls, relative_half_width=0.01))
    assert sum(map(len, outcomes)) == max_calls
    assert last.stop_reason is StopReason.BUDGET_ENDED
    assert 0.0 <= last.interval[0] <= last.interval[1] <= 1.0
    assert last.interval[1] > P_HALF_PLANE / 2


def test_the_limit_on_draws_ends_it():
    last, _, _ = run(problem(relative_half_width=1e-3), settings=replace(SMALL, max_draws=2000))
    assert last.stop_reason is StopReason.DRAWS_ENDED
    assert last.n_draws == 2000
    assert Alarm.TARGET_NOT_REACHED in last.alarms


def test_equal_seeds_ask_for_equal_situations():
    (_, one, _), (_, two, _), (_, other, _) = (run(problem(seed=s)) for s in (5, 5, 6))
    assert len(one) == len(two)
    assert all(np.array_equal(a.x, b.x) for a, b in zip(one, two, strict=True))
    assert not np.array_equal(one[0].x, other[0].x)


def test_failed_simulations_count_both_ways():
    def failing(x):
        return np.where(np.arange(len(x)) % 4 == 0, np.nan, half_plane(x))

    last, _, _ = run(problem(max_calls=600, relative_half_width=0.05), failing)
    assert last.learned.contradictions == 0
    assert last.interval[0] < P_HALF_PLANE < last.interval[1]
    center = (last.interval[0] + last.interval[1]) / 2
    assert center > last.probability  # the upper end alone carries the failed ones


def test_without_any_crash_the_interval_reaches_the_truth():
    last, _, _ = run(problem(max_calls=200), lambda x: np.zeros(len(x), bool))
    assert last.probability == 0.0
    assert last.interval[0] == 0.0
    assert 0 < last.interval[1] < 0.2
    assert Alarm.NO_CRASH_FOUND in last.alarms


def test_an_order_that_is_wrong_raises_an_alarm():
    def disc(x):
        return ((x - [3.0, 1.0]) ** 2).sum(axis=1) < 1.5

    last, _, _ = run(problem(max_calls=400, relative_half_width=0.05), disc)
    assert Alarm.ORDER_CONTRADICTED in last.alarms


def test_audits_correct_implied_labels_without_bias():
    """The expected correction is the sum of weight times error, whatever the chances."""
    p = problem()
    rng = np.random.default_rng(0)
    x = rng.uniform(-3, 6, (300, 2))
    seen = np.array([[1.0, 1.0], [0.5, -1.0], [-1.0, 0.5], [2.0, 0.0]])
    labels = Labels.empty(p).add(seen, np.array([1.0, 0.0, 0.0, 1.0]))
    simulated = np.zeros(300, bool)
    simulated[:60] = True
    settled = Settled(labels, x, np.full(300, np.nan), simulated)
    w = rng.exponential(size=300)
    chance = _audit_chances(settled, w, share=0.5)
    implied = settled.implied
    decided = ~np.isnan(implied) & ~simulated
    assert (chance[decided] > 0).all()
    assert (chance[~decided] == 0).all()
    assert 20 < chance.sum() <= 0.5 * 60
    truth = half_plane(x).astype(float)
    wrong = np.where(decided, truth - np.nan_to_num(implied), 0.0)
    assert np.abs(wrong).sum() > 10
    rows = rng.random((20_000, 300)) < chance
    factor = np.divide(w * wrong, chance, out=np.zeros(300), where=chance > 0)
    corrections = rows @ factor
    error = corrections.std() / math.sqrt(len(corrections))
    assert corrections.mean() == pytest.approx(w @ wrong, abs=4 * error)


def test_curved_risk_coordinates_work_and_bounds_come_from_draws():
    risk = {"size": (lambda x: np.hypot(x[:, 0] + 6, x[:, 1] + 6), "increasing")}

    def far(x):
        return np.hypot(x[:, 0] + 6, x[:, 1] + 6) >= 12.0

    last, _, _ = run(problem(risk, relative_half_width=0.15), far)
    draws = np.random.default_rng(0).standard_normal((4_000_000, 2))
    p = far(draws).mean()
    assert last.probability == pytest.approx(p, rel=0.35)
    assert last.bounds[0] < p < last.bounds[1]
    assert last.bounds[1] < 3 * p


def test_a_campaign_runs_it():
    campaign = Campaign(
        problem().traffic, risk=UP, method="huang2017", relative_half_width=0.3, seed=1
    )
    while not campaign.done:
        campaign.tell(half_plane(campaign.ask()))
    result = campaign.estimate()
    assert result.method == "huang2017"
    assert result.interval[0] < P_HALF_PLANE < result.interval[1]
    assert result.bounds[0] < P_HALF_PLANE < result.bounds[1]
    assert isinstance(campaign.snapshot, Huang2017Snapshot)


def test_an_order_is_needed():
    with pytest.raises(InvalidInputError, match="expected a risk order, got None"):
        huang2017(problem(risk=None))


@pytest.mark.parametrize(
    "changes", [{"n_per_iteration": 0}, {"defensive_share": 0.0}, {"audit_share": 1.0}]
)
def test_bad_settings_are_refused(changes):
    with pytest.raises(InvalidInputError, match=next(iter(changes))):
        Huang2017Settings(**changes)
