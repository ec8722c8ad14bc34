"""A few of the tables of benchmarks/malformed.py, which tries ten thousand."""

import importlib.util
from collections import Counter
from pathlib import Path

MALFORMED = Path(__file__).resolve().parents[2] / "benchmarks" / "malformed.py"
N = 150


def test_malformed_tables_are_fitted_or_refused_in_our_words(tmp_path):
    spec = importlib.util.spec_from_file_location("malformed", MALFORMED)
    malformed = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(malformed)
    found = malformed.study(N, tmp_path)
    ends = Counter(end for _, _, end in found)
    assert not [line for line in found if line[2].startswith("UNEXPECTED")]
    assert ends["fitted"] > N // 5  # the study reaches the fit
    assert ends["EventsError"] > N // 5
