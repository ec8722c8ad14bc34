import json
import pickle
import subprocess
import sys

import numpy as np
import pytest
from scipy.stats import kstest, multivariate_normal

from crashrate.errors import InvalidInputError
from crashrate.traffic.model import TrafficModel

INF = np.inf


def two_components(**changes):
    values = {
        "weights": [0.3, 0.7],
        "means": [[0.0, 1.0], [3.0, -0.5]],
        "covariances": [[[1.0, 0.4], [0.4, 0.5]], [[0.6, -0.2], [-0.2, 2.0]]],
        "lower": [-0.5, 0.0],
        "upper": [4.0, 2.5],
        "names": ["speed", "gap"],
        "provenance": {"source": "a test", "units": {"speed": "m/s"}},
    }
    return TrafficModel(**(values | changes))


def grid(lower, upper, n=60):
    x, w = np.polynomial.legendre.leggauss(n)
    half = 0.5 * (np.array(upper) - lower)
    axes = [lo + h * (1 + x) for lo, h in zip(lower, half, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, len(half))
    weights = np.stack(np.meshgrid(*[h * w for h in half], indexing="ij"), -1)
    return points, weights.prod(axis=-1).ravel()


def test_density_integrates_to_one_and_is_zero_outside():
    model = two_components()
    points, weights = grid(model.lower, model.upper)
    density = np.exp(model.log_density(points))
    assert weights @ density == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose((weights * density) @ points, model.mean, rtol=1e-12)
    away = points - model.mean
    second = (away * (weights * density)[:, None]).T @ away
    np.testing.assert_allclose(second, model.covariance, rtol=1e-11)
    outside = [[-0.6, 1.0], [1.0, 2.6]]
    assert (model.log_density(outside) == -INF).all()
    assert (model.log_component_densities(outside) == -INF).all()
    assert model.contains([[0.0, 1.0], [9.0, 9.0]]).tolist() == [True, False]


def test_density_is_the_truncated_mixture():
    model = two_components()
    x = model.sample(50, 1)
    parts = np.stack(
        [
            np.log(w) + multivariate_normal(m, c).logpdf(x) - p
            for w, m, c, p in zip(
                model.weights, model.means, model.covariances, model.log_masses, strict=True
            )
        ],
        axis=1,
    )
    np.testing.assert_allclose(model.log_component_densities(x), parts, rtol=1e-12, atol=1e-12)
    together = np.logaddexp.reduce(parts, axis=1)
    np.testing.assert_allclose(model.log_density(x), together, rtol=1e-12, atol=1e-12)
    shares = np.exp(parts - together[:, None])
    np.testing.assert_allclose(model.component_probabilities(x), shares, rtol=1e-10, atol=1e-14)


def test_box_probabilities_are_integrals_and_add_up():
    model = two_components()
    lo, hi = np.array([0.2, 0.4]), np.array([1.7, 2.0])
    points, weights = grid(lo, hi)
    p = model.box_probability(lo, hi)
    assert p.ndim == 0
    assert p == pytest.approx(weights @ np.exp(model.log_density(points)), rel=1e-10)
    cuts = np.array([-INF, 0.0, 1.0, 3.0, INF])
    strips = model.box_probability(
        np.stack([cuts[:-1], np.full(4, -INF)], 1), np.stack([cuts[1:], np.full(4, INF)], 1)
    )
    assert strips.sum() == pytest.approx(1.0, abs=1e-12)
    nothing = model.box_probability([[5.0, 0.0], [1.0, 1.0]], [[6.0, 1.0], [1.0, 2.0]])
    assert nothing.tolist() == [0.0, 0.0]


def test_draws_follow_the_model():
    model = two_components()
    x = model.sample(20_000, np.random.default_rng(3))
    assert model.contains(x).all()
    scores = (x.mean(axis=0) - model.mean) / np.sqrt(np.diag(model.covariance) / len(x))
    assert np.abs(scores).max() < 4.0
    ends = np.linspace(model.lower[0], model.upper[0], 300)
    lo = np.tile(model.lower, (300, 1))
    hi = np.stack([ends, np.full(300, INF)], axis=1)
    cdf = model.box_probability(lo, hi)
    assert kstest(x[:, 0], lambda v: np.interp(v, ends, cdf)).pvalue > 1e-3
    assert kstest(x[:, 0] ** 1 * 0.98, lambda v: np.interp(v, ends, cdf)).pvalue < 1e-3
    first, second = x[:10_000, 0], x[10_000:, 0]
    assert abs(first.mean() - second.mean()) < 4 * first.std() / np.sqrt(5000)  # shuffled


def test_seeds_repeat_and_zero_draws_have_columns():
    model = two_components()
    np.testing.assert_array_equal(model.sample(10, 5), model.sample(10, 5))
    assert model.sample(0, 1).shape == (0, 2)
    with pytest.raises(InvalidInputError, match="draws >= 0"):
        model.sample(-1)


def test_json_brings_back_every_bit(tmp_path):
    model = two_components(weights=[1 / 3, 2 / 3], upper=[4.0, INF])
    text = model.to_json(tmp_path / "model.json")
    for back in (
        TrafficModel.from_json(text),
        TrafficModel.from_json(tmp_path / "model.json"),
        TrafficModel.from_json(str(tmp_path / "model.json")),
        pickle.loads(pickle.dumps(model)),  # noqa: S301 - our own bytes
    ):
        assert back == model
        assert not back.means.flags.writeable
        assert hash(back) == hash(model)
        np.testing.assert_array_equal(back.weights, model.weights)
        assert back.provenance == model.provenance
    assert json.loads(text)["upper"] == [4.0, None]
    assert model != two_components()
    assert model != "a model"


def test_json_that_is_not_a_model_is_refused(tmp_path):
    document = json.loads(two_components().to_json())
    cases = {
        "expected the JSON of a traffic model": "{",
        "whose schema is": json.dumps({"schema": "other"}),
        "expected version 1": json.dumps(document | {"version": 2}),
        "unknown key 'wieghts'; did you mean 'weights'": json.dumps(document | {"wieghts": []}),
        "lists of numbers": json.dumps(document | {"means": [["a", "b"]]}),
        "expected the keys means": json.dumps({k: document[k] for k in document if k != "means"}),
    }
    for words, text in cases.items():
        with pytest.raises(InvalidInputError, match=words):
            TrafficModel.from_json(text)
    with pytest.raises(InvalidInputError, match=r"no\.json.*expected a JSON file"):
        TrafficModel.from_json(tmp_path / "no.json")
    with pytest.raises(InvalidInputError, match=r"got dict; json\.dumps"):
        TrafficModel.from_json({})


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"weights": [0.3, 0.6]}, "sum to 1.*0.9"),
        ({"weights": [1.3, -0.3]}, "numbers >= 0"),
        ({"means": [[0.0, 1.0]]}, r"means: expected shape \(2, 2\).*got \(1, 2\)"),
        ({"means": [[0.0, np.nan], [0, 0]]}, "means: expected finite"),
        ({"covariances": [[[1.0, 2.0], [2.0, 1.0]]] * 2}, "covariance 0: .*positive definite"),
        ({"covariances": [[[1.0, 0.5], [0.0, 1.0]]] * 2}, "covariance 0: .*symmetric"),
        ({"names": ["speed", "speed"]}, "each name once"),
        ({"names": ["speed", "a gap"]}, "identifiers such as 'v_lead', got 'a gap'"),
        ({"names": []}, "at least one variable"),
        ({"lower": [4.0, 0.0]}, "variable 'speed': expected lower < upper"),
        ({"means": [[0.0, 1.0], [3.0, 90.0]]}, "component 1: .*log probability"),
        ({"provenance": {"when": object()}}, "that JSON can hold"),
        (
            {"means": [[0.0, 1.0], [3.0]]},
            r"means: expected numbers, rows .* got \[\[0.0, 1.0\], \[3",
        ),
        ({"weights": ["a", "b"]}, r"weights: expected numbers.*got \['a', 'b'\]"),
        ({"names": "ab"}, "expected a list of names.*the text 'ab'"),
        ({"members": [1]}, r"members\[0\]: expected a traffic model, got int"),
    ],
)
def test_bad_models_are_refused(changes, words):
    with pytest.raises(InvalidInputError, match=words):
        two_components(**changes)


def test_bad_rows_and_boxes_are_refused():
    model = two_components()
    with pytest.raises(InvalidInputError, match=r"x: expected numbers.*got \[\['a', 'b'\]\]"):
        model.log_density([["a", "b"]])
    with pytest.raises(InvalidInputError, match=r"\(n, 2\), got \(3,\)"):
        model.log_density([1.0, 2.0, 3.0])
    with pytest.raises(InvalidInputError, match="row 0, column 1"):
        model.log_density([[1.0, np.nan]])
    with pytest.raises(InvalidInputError, match=r"speed, gap, got \(3,\)"):
        model.box_probability([1.0, 2.0, 3.0], [1.0, 2.0])
    with pytest.raises(InvalidInputError, match="nan in it"):
        model.box_probability([1.0, np.nan], [1.0, 2.0])
    with pytest.raises(InvalidInputError, match="as many boxes"):
        model.box_probability(np.zeros((2, 2)), np.ones((3, 2)))


@pytest.mark.parametrize("n", [-1, 10.5, "ten", True, None])
def test_numbers_of_draws_that_are_none_are_refused(n):
    with pytest.raises(InvalidInputError, match="n: expected a whole number of draws >= 0, got "):
        two_components().sample(n)


def test_weights_are_normalised_only_where_they_have_to_be():
    model = two_components(weights=[0.3, 0.7 + 1e-8])
    assert model.weights.sum() == pytest.approx(1.0, abs=1e-15)
    assert not model.weights.flags.writeable
    empty = two_components(weights=[1.0, 0.0])
    assert np.isfinite(empty.log_density([[0.0, 1.0]])).all()
    assert empty.component_masses.shape == (2,)


def test_the_model_loads_no_heavy_library():
    heavy = ["sklearn", "scipy.stats", "scipy.optimize", "pyarrow"]
    code = f"import sys, crashrate.datasets; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
