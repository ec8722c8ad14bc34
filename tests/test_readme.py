"""README's promises: its Python code runs, its commands and files exist."""

import re
import shlex
from pathlib import Path

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from crashrate.cli import app

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


def commands():
    lines = "\n".join(blocks("sh")).splitlines()
    parts = [part.strip() for line in lines for part in line.split("&&")]
    return [part for part in parts if part.startswith("crashrate ")]


def test_python_code_runs(capsys):
    names = {}
    for code in blocks("python"):
        exec(compile(code, "README.md", "exec"), names)  # noqa: S102
    printed = capsys.readouterr().out
    assert printed.startswith("P(crash) = ")
    assert 1e-6 < names["result"].probability < 4e-6  # 1.976e-6; coverage is tested elsewhere
    assert names["campaign"].done


@pytest.mark.parametrize("line", commands())
def test_commands_are_understood(line):
    words = shlex.split(line)[1:]
    group = get_command(app)
    with group.make_context("crashrate", words[:0], resilient_parsing=True) as parent:
        command = group.get_command(parent, words[0])
        assert command is not None
        command.make_context(words[0], words[1:], parent=parent)


def test_every_command_explains_itself():
    group = get_command(app)
    for name in group.commands:
        result = CliRunner().invoke(app, [name, "--help"])
        assert result.exit_code == 0
        assert "Examples:" in result.output


def test_linked_files_exist():
    links = re.findall(r"\]\(([^)#:]+)\)", README)
    assert links
    assert [link for link in links if not (ROOT / link).exists()] == []
