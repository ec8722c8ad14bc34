"""The package as a whole: light to import, typed, complete."""

import subprocess
import sys
from importlib.resources import files

import pytest

import crashrate

HEAVY = ("scipy", "sklearn", "pyarrow", "plotly", "jinja2", "rich", "typer", "numpy")


def test_importing_it_imports_nothing_heavy():
    code = f"import sys, crashrate; print(*[m for m in {HEAVY} if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == []


@pytest.mark.parametrize("name", crashrate.__all__)
def test_every_public_name_is_there_and_documented(name):
    value = getattr(crashrate, name)
    assert isinstance(value, str) or value.__doc__


def test_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'estimat'"):
        crashrate.estimat  # noqa: B018


def test_marked_as_typed():
    assert files("crashrate").joinpath("py.typed").is_file()


def test_errors_are_one_tree():
    errors = [e for e in vars(crashrate.errors).values() if isinstance(e, type)]
    assert errors
    assert all(issubclass(e, crashrate.errors.CrashrateError) for e in errors)
