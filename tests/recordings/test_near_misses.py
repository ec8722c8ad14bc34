import numpy as np
import pytest

from crashrate.recordings.near_misses import Quantity, Tail, tail_of, tails

A = Quantity("a", "m", lambda x: x[:, 0], 1.0)
MINUS_A = Quantity("-a", "m", lambda x: -x[:, 0], -1.0)


def found(seed, deviation=1.0, quantity=A, n=20_000):
    rng = np.random.default_rng(seed)
    return tail_of(quantity, rng.normal(size=(n, 1)), deviation * rng.normal(size=(10 * n, 1)))


def inside(tail):
    return [
        low <= e <= high for low, e, high in zip(tail.low, tail.expected, tail.high, strict=True)
    ]


def test_right_model_expects_what_is_seen():
    share = np.mean([inside(found(seed)) for seed in range(60)])
    assert 0.92 < share < 0.995


def test_as_many_draws_as_events_widen_the_range():
    rng = np.random.default_rng(0)
    shares = []
    for _ in range(40):
        events, draws = rng.normal(size=(2, 20_000, 1))
        shares.append(inside(tail_of(A, events, draws)))
    assert np.mean(shares) > 0.92


def test_tail_too_light_is_seen():
    assert np.mean([inside(found(seed, 0.9))[1] for seed in range(10)]) < 0.2


def test_the_dangerous_side_may_be_the_small_one():
    up, down = found(1), found(1, quantity=MINUS_A)
    assert down.levels == tuple(-level for level in up.levels)
    assert down.expected == up.expected
    assert down.observed_quantiles == tuple(-q for q in up.observed_quantiles)


def test_ranks_are_those_that_the_events_can_tell():
    tail = found(1, n=2000)
    assert tail.counts == (10, 100)
    assert list(tail.observed_quantiles) == sorted(tail.observed_quantiles, reverse=True)
    assert tail.model_quantiles[10] == pytest.approx(tail.observed_quantiles[10], rel=0.2)


def test_a_quantity_that_does_not_vary_is_left_out():
    still = Quantity("c", "", lambda x: np.zeros(len(x)), 1.0)
    x = np.random.default_rng(0).normal(size=(1000, 1))
    assert [t.name for t in tails((still, A), x, x)] == ["a"]


def test_survives_a_file():
    tail = found(0)
    assert Tail.from_dict(tail.to_dict()) == tail


def test_rounded_values_count_with_their_ties():
    rng = np.random.default_rng(0)
    events, draws = np.round(rng.normal(size=(20_000, 1))), rng.normal(size=(200_000, 1))
    tail = tail_of(A, events, np.round(draws))
    assert tail.levels == tuple(sorted(set(tail.levels), reverse=True))  # no level twice
    assert tail.counts == tuple(int((events >= level).sum()) for level in tail.levels)
    assert all(inside(tail))


def test_a_misfit_is_rare_where_the_model_is_right():
    """Three levels of a quantity, outside at two of them at 99 %: about one recording in 300."""
    assert sum(found(seed).misfit for seed in range(60)) <= 1


@pytest.mark.parametrize("deviation", [0.9, 1.1])
def test_a_misfit_is_seen_on_either_side(deviation):
    assert all(found(seed, deviation).misfit for seed in range(10))


def test_one_level_outside_is_no_misfit():
    tail = found(0)
    odd = Tail.from_dict(tail.to_dict() | {"expected": [0.0, *tail.expected[1:]]})
    assert odd.outside == (True, *tail.outside[1:])


@pytest.mark.parametrize("step", [0.2, 0.5])
def test_rounded_values_raise_no_alarm(step):
    """The model's draws are not rounded: a level lies between two values, not on one."""
    raised = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        events = np.round(rng.normal(size=(20_000, 1)) / step) * step
        raised += tail_of(A, events, rng.normal(size=(200_000, 1))).misfit
    assert raised <= 1
