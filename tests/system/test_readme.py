"""The README's commands, tables and example."""

import re
import shlex
from pathlib import Path

import pytest

from jaxscp.cli import app as cli

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


def test_both_commands_are_single_lines_that_start_from_nothing():
    plan, tests = (block.strip() for block in blocks("sh"))
    for line in (plan, tests):
        assert "\n" not in line
        assert line.startswith("python3 -m venv .venv && .venv/bin/pip install ")
    assert " .venv/bin/jaxscp plan platform " in plan


def test_ci_runs_the_test_command_of_the_readme():
    command = blocks("sh")[1].strip().split(" && ")[-1].removeprefix(".venv/bin/")
    assert command in (ROOT / ".ci" / "run").read_text()


def test_commands_in_prose_are_ones_that_exist():
    for command in re.findall(r"`jaxscp plan ([^`]*)`", README):
        case = shlex.split(command)[0]
        assert case in cli.CASES or case == "--help"


def test_every_mode_is_explained():
    assert set(re.findall(r"^\| `(\w+)` \|", README, flags=re.MULTILINE)) == set(cli.MODES)


def test_pictures_exist_and_are_small():
    pictures = re.findall(r"!\[[^]]+\]\(([^)]+)\)", README)
    assert pictures
    for picture in pictures:
        assert (ROOT / picture).stat().st_size < 300_000


@pytest.mark.slow
def test_python_example_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (example,) = blocks("python")
    exec(compile(example, "README.md", "exec"), {})
    assert "converged" in capsys.readouterr().out
    assert {file.name for file in tmp_path.iterdir()} == {"plan.npz", "plan.png"}
