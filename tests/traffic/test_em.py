import numpy as np
import pytest

from crashrate.traffic.em import information_em_step, lee_scott_step, lee_scott_target
from crashrate.traffic.natural import to_natural
from crashrate.traffic.objective import Events, Prior, mixture_at, theta_gradient
from crashrate.traffic.truncated_components import Box, components_at


def exponential_events(d):
    x = np.random.default_rng(0).exponential(size=(200, d))
    y = (x - x.mean(axis=0)) / x.std(axis=0)
    return Events(y, Box(-x.mean(axis=0) / x.std(axis=0), np.full(d, np.inf)))


def no_prior(d):
    return Prior(0.0, np.zeros(d), np.eye(d))


def one_component(events, prior, mean, covariance):
    theta = to_natural(np.array([mean]), np.array([covariance]))
    return mixture_at(events, prior, np.zeros(1), components_at(theta, events.box))


def test_target_of_one_variable_is_the_papers():
    events, prior = exponential_events(1), no_prior(1)
    mixture = one_component(events, prior, [-2.0], [[3.0]])
    (mean,), (covariance,) = lee_scott_target(prior, mixture)
    y = events.rows[:, 0]
    box_mean = mixture.components.box_means[0, 0]
    box_variance = mixture.components.box_covariances[0, 0, 0]
    m = box_mean + 2.0  # (eq. 7)
    h = 3.0 - (box_variance + m**2)  # (eq. 8): the second moment is about the mean
    assert mean[0] == pytest.approx(y.mean() - m)  # (eq. 5)
    assert covariance[0, 0] == pytest.approx(((y - mean[0]) ** 2).mean() + h)  # (eq. 6)


def test_a_step_that_would_lower_the_likelihood_is_replaced():
    events, prior = exponential_events(3), no_prior(3)
    covariance = 2.0 * (1.4 * np.eye(3) - 0.4)
    before = one_component(events, prior, [20.0, 0.0, -30.0], covariance)
    means, covariances = lee_scott_target(prior, before)
    # Negative control: the paper's own step falls by 13 nats an event.
    raw = one_component(events, prior, means[0], covariances[0])
    assert raw.objective < before.objective - 10.0
    step = lee_scott_step(events, prior, before)
    assert step.mixture.objective > before.objective
    assert step.n_safeguarded == 1


@pytest.mark.parametrize("stepper", [lee_scott_step, information_em_step])
def test_steps_settle_where_the_gradient_is_zero(stepper):
    rng = np.random.default_rng(2)
    y = np.abs(rng.normal(size=(500, 2)) + 0.5)
    events = Events(y, Box(np.zeros(2), np.full(2, np.inf)))
    prior = Prior(1.0, y.mean(axis=0), np.cov(y.T))
    mixture = one_component(events, prior, y.mean(axis=0), np.cov(y.T))
    for _ in range(400):
        mixture = stepper(events, prior, mixture).mixture
    assert np.abs(theta_gradient(prior, mixture)).max() < 1e-2 * len(y)
    if stepper is information_em_step:  # Newton's steps: to the end
        assert np.abs(theta_gradient(prior, mixture)).max() < 1e-6 * len(y)


def test_blocks_of_events_do_not_matter():
    y = np.random.default_rng(1).normal(size=(10_000, 2))
    events = Events(y, Box(np.full(2, -np.inf), np.full(2, np.inf)))
    mixture = one_component(events, no_prior(2), [0.1, 0.2], np.eye(2))
    seen = mixture.expectation
    assert seen.counts[0] == pytest.approx(10_000)
    np.testing.assert_allclose(seen.sums[0, :2], y.sum(axis=0), rtol=1e-9)
    products = [-0.5 * y[:, 0] @ y[:, 0], -y[:, 0] @ y[:, 1], -0.5 * y[:, 1] @ y[:, 1]]
    np.testing.assert_allclose(seen.sums[0, 2:], products, rtol=1e-9)
