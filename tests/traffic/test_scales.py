"""Variables modelled by their logarithm, against the log-normal law and against logged data."""

import copy
import math

import numpy as np
import pytest
from scipy.integrate import dblquad
from scipy.stats import kstest, lognorm, truncnorm

from crashrate.crash_set.order import RiskOrder
from crashrate.errors import InvalidInputError
from crashrate.estimation.run import estimate
from crashrate.expressions import Expression
from crashrate.sampling.orthants import orthant_constraints
from crashrate.traffic.mixture import TruncatedGaussianMixture
from crashrate.traffic.model import TrafficModel
from crashrate.traffic.scales import Scales

LOG, LINEAR = "log", "linear"


def log_normal(lower=0.0, upper=np.inf):
    return TrafficModel([1.0], [[0.3]], [[[0.25]]], [lower], [upper], ("a",), scales=[LOG])


def two(lower=(0.0, -np.inf), upper=(np.inf, np.inf), scales=(LOG, LINEAR)):
    covariances = [[[0.2, 0.1], [0.1, 0.4]], [[0.3, 0.0], [0.0, 0.2]]]
    return TrafficModel(
        [0.6, 0.4], [[0.0, 1.0], [-0.5, 2.0]], covariances, lower, upper, ("a", "b"), scales=scales
    )


def test_one_normal_component_on_a_log_scale_is_the_log_normal_law():
    law, model = lognorm(0.5, scale=math.exp(0.3)), log_normal()
    x = np.array([[0.1], [1.0], [7.0]])
    assert model.log_density(x) == pytest.approx(law.logpdf(x[:, 0]))
    assert model.box_probability([0.5], [2.0]) == pytest.approx(law.cdf(2.0) - law.cdf(0.5))
    assert kstest(model.sample(4000, 1)[:, 0], law.cdf).pvalue > 1e-3


def test_truncation_is_in_the_units_of_the_data():
    model = log_normal(1.0, 2.0)
    z = truncnorm((0.0 - 0.3) / 0.5, (math.log(2) - 0.3) / 0.5, 0.3, 0.5)
    x = model.sample(4000, 2)
    assert model.contains(x).all()
    assert kstest(np.log(x[:, 0]), z.cdf).pvalue > 1e-3
    assert model.log_density([[0.9], [2.1]]).tolist() == [-np.inf, -np.inf]
    assert model.log_density([[1.5]])[0] == pytest.approx(z.logpdf(math.log(1.5)) - math.log(1.5))


def test_density_integrates_to_one_and_to_the_box_probability():
    model = two(lower=(0.2, 0.0), upper=(5.0, 4.0))
    f = lambda b, a: math.exp(model.log_density([[a, b]])[0])  # noqa: E731
    assert dblquad(f, 0.2, 5.0, 0.0, 4.0, epsabs=1e-7)[0] == pytest.approx(1.0, abs=1e-5)
    part = dblquad(f, 0.5, 1.5, 1.0, 2.0, epsabs=1e-8)[0]
    assert model.box_probability([0.5, 1.0], [1.5, 2.0]) == pytest.approx(part, rel=1e-6)


def test_component_densities_add_up():
    model = two()
    x = model.sample(50, 3)
    parts = model.log_component_densities(x)
    assert np.logaddexp.reduce(parts, axis=1) == pytest.approx(model.log_density(x))
    shares = np.exp(parts - model.log_density(x)[:, None])
    assert model.component_probabilities(x) == pytest.approx(shares)


def test_outside_the_logarithm_there_is_no_density():
    assert two().log_density([[0.0, 1.0], [-1.0, 1.0]]).tolist() == [-np.inf, -np.inf]
    assert two().log_component_densities([[-1.0, 1.0]]).tolist() == [[-np.inf, -np.inf]]


def test_copies_keep_the_scales(tmp_path):
    model = two()
    model.to_json(tmp_path / "model.json")
    for again in (
        TrafficModel.from_json(tmp_path / "model.json"),
        copy.deepcopy(model),
    ):
        assert again == model
        assert again.scales == model.scales
    assert two(scales=(LINEAR, LINEAR)) != model
    assert "scales" not in two(scales=None).to_json()  # as every earlier file


def test_modelled_is_the_law_of_the_logarithms():
    model, x = two(lower=(0.2, 0.0)), two(lower=(0.2, 0.0)).sample(20, 4)
    z = np.column_stack([np.log(x[:, 0]), x[:, 1]])
    inner = model.modelled
    assert inner.lower.tolist() == [math.log(0.2), 0.0]
    assert inner.log_density(z) == pytest.approx(model.log_density(x) + np.log(x[:, 0]))
    assert model.from_modelled(z) == pytest.approx(x)
    assert model.contains(model.from_modelled(inner.lower[None])).all()  # rounding or not
    assert inner.modelled is inner


@pytest.mark.parametrize(
    ("scales", "message"),
    [
        (["log"], "one for each of 2 variables"),
        ("log", "one for each of 2 variables"),
        (["log", "logarithmic"], r"scales\[1\]: expected 'linear' or 'log', got 'logarithmic'"),
        (["linear", "log"], "'b': expected lower >= 0 on a log scale, got lower = -inf"),
    ],
)
def test_bad_scales_are_refused(scales, message):
    with pytest.raises(InvalidInputError, match=message):
        two(scales=scales)


def order(model, **risk):
    return RiskOrder.from_mapping(risk, model.names).on(model.scales)


def test_an_order_on_modelled_rows_is_that_of_the_situations():
    model = two()
    x = model.sample(30, 5)
    plain = RiskOrder.from_mapping({"a": "decreasing", "b": "increasing"}, model.names)
    assert plain.on(model.scales)(model.scales.forward(x)) == pytest.approx(plain(x))
    assert plain.on(Scales.parse(None, 2)) is plain


@pytest.mark.parametrize(
    ("text", "direction", "level"),
    [("1 / a", "decreasing", -0.7), ("1 / a", "increasing", 0.7), ("2 * a - 1", "increasing", 0.5),
     ("2 * b", "increasing", 2.0), ("a", "increasing", -1.0), ("a", "decreasing", 1.0)],
)  # fmt: skip
def test_half_spaces_of_one_logarithm_are_exact(text, direction, level):
    model = two(lower=(0.1, -1.0), upper=(9.0, 9.0))
    risk = order(model, r=(Expression(text, model.names), direction))
    z = model.scales.forward(model.sample(200, 6))
    inside = model.modelled
    found = risk.half_space(0, level, inside.lower, inside.upper)
    assert np.array_equal(found.contains(z), risk(z)[:, 0] >= level)


def test_what_mixes_a_logarithm_with_another_variable_is_no_half_space():
    model = two(lower=(0.1, -1.0), upper=(9.0, 9.0))
    risk = order(model, r=(Expression("a + b", model.names), "increasing"))
    assert risk.half_space(0, 1.0, model.modelled.lower, model.modelled.upper) is None


def exact_case():
    """ln a and b normal: a e^b > e^level has the probability of a normal tail, 1e-5."""
    from scipy.stats import norm

    traffic = TrafficModel(
        [1.0], [[0.0, 0.0]], [np.eye(2)], [0.0, -np.inf], [np.inf, np.inf], ("a", "b"),
        scales=[LOG, LINEAR],
    )  # fmt: skip
    level = math.sqrt(2) * norm.isf(1e-5)
    return traffic, lambda x: np.log(x[:, 0]) + x[:, 1] > level


@pytest.mark.parametrize("seed", range(3))
def test_campaigns_simulate_in_the_units_of_the_data(seed):
    traffic, crash = exact_case()
    seen = []

    def simulate(x):
        seen.append(x)
        return crash(x)

    risk = {"a": "increasing", "b": "increasing"}
    got = estimate(simulate, traffic, risk=risk, seed=seed, max_calls=300)
    assert np.concatenate(seen)[:, 0].min() > 0.0
    assert abs(got.probability / 1e-5 - 1) < 0.2
    assert got.bounds[0] < 1e-5 < got.bounds[1]
    assert got.n_calls < 250


def test_a_fit_on_a_log_scale_is_the_fit_of_the_logarithms():
    rows = two(lower=(0.2, 0.0)).sample(3000, 7)
    logged = np.column_stack([np.log(rows[:, 0]), rows[:, 1]])
    options = {"random_state": 0, "upper": None}
    scaled = TruncatedGaussianMixture(2, lower=[0.2, 0.0], scales=[LOG, LINEAR], **options)
    plain = TruncatedGaussianMixture(2, lower=[math.log(0.2), 0.0], **options)
    scaled.fit(rows)
    plain.fit(logged)
    assert scaled.means_ == pytest.approx(plain.means_)
    assert scaled.covariances_ == pytest.approx(plain.covariances_)
    # its likelihood is of the data: the Jacobian's difference from that of the logarithms
    jacobian = np.log(rows[:, 0]).sum()
    assert scaled.log_likelihood_ == pytest.approx(plain.log_likelihood_ - jacobian)
    assert scaled.score_samples(rows).sum() == pytest.approx(scaled.log_likelihood_)
    assert scaled.bic(rows) == pytest.approx(scaled.bic_)
    assert scaled.model_.scales == Scales.parse([LOG, LINEAR], 2)


def test_the_criterion_prefers_the_scale_that_is_true():
    rows = np.exp(np.random.default_rng(0).normal(0, 1, (2000, 1)))
    log, linear = (
        TruncatedGaussianMixture(1, lower=0.0, scales=[s], random_state=0).fit(rows).bic_
        for s in (LOG, LINEAR)
    )
    assert log < linear - 100


def test_an_event_without_a_logarithm_is_named():
    with pytest.raises(InvalidInputError, match=r"positive numbers of x1.*got 0.0 at row 2"):
        TruncatedGaussianMixture(1, scales=[LINEAR, LOG]).fit([[1.0, 1.0], [2.0, 2.0], [3.0, 0.0]])


def test_curved_constraints_are_of_the_situations():
    model = two(lower=(0.1, -1.0), upper=(9.0, 9.0))
    risk = order(model, r=(lambda x: x[:, 1] / x[:, 0], "increasing"), b="increasing")
    (curved,) = orthant_constraints(risk, np.array([4.0, 1.0]), model.modelled).curved
    z = model.scales.forward(model.sample(50, 8))
    assert curved.values(z) == pytest.approx(risk(z)[:, 0])
    assert curved.level == 4.0
