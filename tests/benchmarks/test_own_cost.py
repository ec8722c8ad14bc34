"""The cheap parts of benchmarks/own_cost.py: checkpoints, giving up, growth, the rows."""

import math
import sys
from types import SimpleNamespace

import numpy as np
import pytest

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="resource is of POSIX")


class Asked:
    """A campaign that asks for ten situations at a time until its budget is spent."""

    def __init__(self, budget):
        self.budget, self.n_calls = budget, 0

    @property
    def done(self):
        return self.n_calls >= self.budget

    def ask(self):
        return np.zeros((min(10, self.budget - self.n_calls), 2))

    def tell(self, outcomes):
        self.n_calls += len(outcomes)

    def estimate(self):
        return SimpleNamespace(relative_half_width=math.inf)


def ticking(monkeypatch, own_cost):
    """Process time that grows by a second whenever it is read."""
    clock = iter(range(10**6))
    monkeypatch.setattr(own_cost.time, "process_time", lambda: float(next(clock)))


def never(x):
    return np.zeros(len(x), dtype=bool)


def test_a_row_at_every_checkpoint_and_at_the_end(monkeypatch):
    import own_cost

    ticking(monkeypatch, own_cost)
    found = list(own_cost.costs(Asked(305), SimpleNamespace(crash=never), math.inf))
    assert [cost.n_calls for cost in found] == [100, 300, 305]
    # a second to ask and a second to tell; that of the simulator is not the campaign's
    assert [cost.latest for cost in found] == [2, 2, 2]
    assert [cost.total for cost in found] == [20, 60, 62]
    assert all(cost.longest == 2 and cost.peak > 10 for cost in found)


def test_a_campaign_over_its_seconds_is_given_up_with_a_row(monkeypatch):
    import own_cost

    ticking(monkeypatch, own_cost)
    found = list(own_cost.costs(Asked(10_000), SimpleNamespace(crash=never), 30))
    assert [cost.n_calls for cost in found] == [100, 160]
    assert found[-1].total == 32


def test_growth_is_the_power_of_the_number_of_runs():
    from own_cost import Cost, exponent

    now = Cost(1200, 8.0, 9.0, 100.0, 200.0, 0.1)
    assert exponent(Cost(600, 2.0, 2.0, 50.0, 100.0, 0.1), now) == "n^2.0"
    assert exponent(Cost(600, 16.0, 16.0, 50.0, 100.0, 0.1), now) == "n^\N{MINUS SIGN}1.0"
    assert exponent(None, now) == "–"
    assert exponent(Cost(1195, 2.0, 2.0, 50.0, 100.0, 0.1), now) == "–"


def test_rows_have_the_columns_of_the_head():
    from own_cost import HEAD, Cost, row

    known = row("C", 10, None, Cost(1200, 0.5, 0.9, 100.0, 200.0, 0.012))
    assert known == "| C | 10 | 1,200 | 0.50 | – | 0.90 | 100 | 200 MiB | ± 1.2 % |"
    unknown = row("C", 10, None, Cost(20, 0.5, 0.9, 100.0, 200.0, math.inf))
    assert unknown.endswith("| – |")
    assert {text.count("|") for text in (known, unknown, *HEAD.splitlines())} == {10}
