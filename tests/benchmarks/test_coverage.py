"""The cheap parts of benchmarks/coverage.py: what is asked for, taken up, and the tables."""

import json
from types import SimpleNamespace

import pytest


def line(problem="A", **values):
    return {
        "problem": problem,
        "seed": 0,
        "method": "sequential",
        "target": 0.1,
        "max_calls": 2000,
        "batch_size": 10,
        "version": "0",
        "calls": 80,
        "probability": 1.1e-6,
        "interval": [0.9e-6, 1.3e-6],
        "reference": 1e-6,
        "covered": True,
        "stop": "TARGET_MET",
        "alarms": [],
        "seconds": 0.5,
    } | values


def options(**values):
    defaults = {
        "problem": ["A"],
        "seeds": range(1),
        "method": "sequential",
        "target": [0.1],
        "max_calls": 2000,
        "batch_size": [10],
    }
    return SimpleNamespace(**defaults | values)


def test_every_problem_target_batch_size_and_seed_is_wanted_once():
    from coverage import KEYS, wanted

    tasks = wanted(
        options(problem=["A", "B"], target=[0.2, 0.1], batch_size=[1, 1000], seeds=range(3))
    )
    assert len({tuple(task[key] for key in KEYS) for task in tasks}) == 24 == len(tasks)


def test_a_file_from_before_batch_sizes_is_taken_up_as_batches_of_ten(tmp_path):
    from coverage import KEYS, lines, wanted
    from study import without

    old = wanted(options())[0]
    del old["batch_size"]
    path = tmp_path / "old.jsonl"
    path.write_text(json.dumps(line() | old).replace('"batch_size": 10, ', "") + "\n")
    assert "batch_size" not in path.read_text()
    missing = without(wanted(options(batch_size=[10, 100])), lines(path), KEYS)
    assert [task["batch_size"] for task in missing] == [100]


@pytest.mark.parametrize("batch_size", [1, 40])
def test_a_seed_is_run_with_its_batch_size(batch_size):
    import crashrate
    from coverage import run_seed, wanted

    task = wanted(options(target=[0.5], max_calls=40, batch_size=[batch_size]))[0]
    record = run_seed(task)
    assert task.items() <= record.items()
    assert record["calls"] <= 40
    assert record["version"] == crashrate.__version__
    assert json.dumps(json.loads(json.dumps(record))) == json.dumps(record)  # NaN is not itself


def test_table_has_a_row_for_each_target_and_batch_size():
    from coverage_table import table

    text = table(
        [
            line(),
            line(seed=1, calls=90, probability=0.9e-6, covered=False),
            line(target=0.2),
            line(batch_size=1000, calls=2000, stop="BUDGET_ENDED"),
        ]
    )
    assert "| A, ± 10 % | 85 [80–90] | 1/2 | 1–99 % | +0.0 ± 10.0 % | 10.0 % | 2/2 | 0.5 |" in text
    assert "| A, ± 20 % | 80 [80–80] | 1/1 |" in text
    assert "| A, ± 10 %, batches of 1,000 | 2000 [2000–2000] | 1/1 |" in text


def test_what_never_happens_has_an_upper_end_and_no_bias():
    from coverage import _progress
    from coverage_table import table

    never = line("never", probability=0.0, reference=0.0, interval=[0.0, 0.0037])
    assert "| upper end 0.0037 | – | 1/1 |" in table([never])
    assert "an upper end of 0.0037, covered" in _progress(never)


def test_a_run_without_an_estimate_is_named_and_spoils_no_mean():
    from coverage_table import table

    none = line(probability=float("nan"), interval=[0.0, 1.0], seed=1)
    assert "| +10.0 ± nan % (1 without an estimate) | 10.0 % |" in table([line(), none])
    assert "| – (1 without an estimate) | – |" in table([none])


def test_calls_by_batch_size():
    from coverage_table import by_batch_size

    records = [line(), line(batch_size=1, calls=70, covered=False), line("B", batch_size=1000)]
    assert by_batch_size(records).splitlines() == [
        "| calls (covered) by batch size | 1 | 10 | 1,000 |",
        "|---|---|---|---|",
        "| A, ± 10 % | 70 (0/1) | 80 (1/1) | – |",
        "| B, ± 10 % | – | – | 80 (1/1) |",
    ]
