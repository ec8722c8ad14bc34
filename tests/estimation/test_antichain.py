import numpy as np

from crashrate.estimation.antichain import antichain


def test_no_two_rows_are_comparable():
    u = np.random.default_rng(0).integers(0, 8, (200, 3)).astype(float)
    rows = antichain(u, 50)
    below = (u[rows][:, None] <= u[rows]).all(axis=2)
    assert len(rows) > 5
    np.testing.assert_array_equal(below, np.eye(len(rows), dtype=bool))


def test_a_chain_is_bisected():
    assert antichain(np.arange(101.0)[:, None], 10).tolist() == [50]


def test_no_more_rows_than_asked_for():
    u = np.stack([np.arange(30.0), -np.arange(30.0)], axis=1)
    assert len(antichain(u, 7)) == 7
    assert len(antichain(u[:0], 7)) == 0
