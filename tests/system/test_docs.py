"""README and docs: every code block runs, in one namespace a page; commands, links, tables and names are true."""

import re
import shlex
import tomllib
from pathlib import Path

import pytest
from typer.testing import CliRunner

import jaxscp
from jaxscp.cli import app as cli
from jaxscp.cli.sweep_config import read_config

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
PAGES = {
    file.relative_to(ROOT).as_posix(): file.read_text()
    for file in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
}
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
RUNNABLE = ("python", "sh")
SLOW = [pytest.mark.slow]
NIGHTLY = [pytest.mark.nightly]
MARKS = {  # pages that compile for more than some seconds; the longest others run by night
    "README.md": SLOW,
    "docs/problems.md": SLOW,
    "docs/first_plan.md": SLOW,
    "docs/replan.md": SLOW,
    "docs/vehicle.md": NIGHTLY,
    "docs/maps.md": NIGHTLY,
    "docs/compile.md": NIGHTLY,
    "docs/control.md": SLOW,
    "docs/mission.md": NIGHTLY,
    "docs/simulation.md": NIGHTLY,
    "docs/sweeps.md": NIGHTLY,
    "docs/batches.md": NIGHTLY,
    "docs/gradients.md": NIGHTLY,
    "docs/converged.md": NIGHTLY,
    "docs/gallery.md": NIGHTLY,
}


def blocks(text, language=r"\w*"):
    """Code blocks, as pairs (language, text)."""
    return re.findall(rf"^```({language})\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)


WITH_CODE = [pytest.param(name, marks=MARKS.get(name, [])) for name, text in PAGES.items() if blocks(text)]


def lines(language):
    return [block.strip() for _, block in blocks(README, language)]


@pytest.mark.parametrize("page", WITH_CODE)
def test_every_block_of_the_page_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    # ``eval`` of annotations and JAX's caches of functions look for the module's name
    namespace = {"__name__": page}
    for language, block in blocks(PAGES[page]):
        if language == "python":
            exec(compile(block, page, "exec"), namespace)
        elif language == "sh":
            for line in block.splitlines():
                run(line)
        elif language == "toml":
            (tmp_path / "page.toml").write_text(block)
            assert read_config(tmp_path / "page.toml").study.count > 0
        else:
            assert language == "", f"{page}: a block in {language!r} is not run"
    for name, value in namespace.items():
        if isinstance(value, jaxscp.Solution) and value.cost.shape == ():
            assert jaxscp.status_names(value.status) == "converged", name


def run(line):
    """Run a command of the package; of an installation, look at the extras."""
    for command in line.split(" && "):
        words = shlex.split(command)
        program = Path(words[0]).name
        if program == "jaxscp":
            result = CliRunner().invoke(cli.app, words[1:])
            assert result.exit_code == 0, result.output
        else:  # environments, and commands that ``.ci/run`` runs
            assert program in ("python", "python3", "pip"), command
            for extras in re.findall(r"(?:\.|jaxscp)\[([\w,]+)\]", command):
                assert set(extras.split(",")) <= set(PROJECT["optional-dependencies"]), command


def test_both_commands_are_single_lines_that_start_from_nothing():
    plan, tests = lines("sh")
    for line in (plan, tests):
        assert "\n" not in line
        assert line.startswith("python3 -m venv .venv && .venv/bin/pip install ")
    assert " .venv/bin/jaxscp plan platform " in plan


def test_ci_runs_the_test_command_of_the_readme():
    command = lines("sh")[1].split(" && ")[-1].removeprefix(".venv/bin/")
    assert command in (ROOT / ".ci" / "run").read_text()


@pytest.mark.parametrize("page", PAGES)
def test_commands_in_prose_are_ones_that_exist(page):
    for command in re.findall(r"`jaxscp plan ([^`]*)`", PAGES[page]):
        first = shlex.split(command)[0]
        assert first in cli.CASES or first in ("--help", "--cloud", "--cache")
    for module in re.findall(r"`python -m (benchmarks[.\w]*)", PAGES[page]):
        file = ROOT / module.replace(".", "/")
        assert file.with_suffix(".py").exists() or (file / "__main__.py").exists(), module


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_to_files(page):
    """Anchors are checked by ``mkdocs build --strict``."""
    for link in re.findall(r"\]\((?!https?:)([^)#]+)[^)]*\)", PAGES[page]):
        assert (ROOT / page).parent.joinpath(link).exists(), link


def test_every_mode_is_explained():
    modes = re.findall(r"^\| `(\w+)` \|", PAGES["docs/modes.md"], flags=re.MULTILINE)
    assert set(modes) == set(cli.MODES)


def test_every_option_of_maps_is_explained():
    result = CliRunner(env={"COLUMNS": "200"}).invoke(cli.app, ["plan", "--help"])
    options = set(re.findall(r"`(--\w+)`", PAGES["docs/maps.md"]))
    assert options
    assert all(option in result.output for option in options)


def test_every_public_name_is_in_the_reference():
    text = "".join(PAGES[name] for name in PAGES if name.startswith("docs/reference/"))
    named = set(re.findall(r"^::: jaxscp\.([\w.]+)$", text, flags=re.MULTILINE))
    rooms = ("conic", "control", "corridor", "mission", "monte_carlo", "plot", "simulation")
    parts = {"airframes", "scenarios"}  # modules: their functions are there by name
    assert set(jaxscp.__all__) - set(rooms) - parts <= named
    for room in rooms:
        assert {f"{room}.{name}" for name in getattr(jaxscp, room).__all__} <= named


def test_pictures_are_small():
    pictures = re.findall(r"!\[[^]]+\]\(([^)]+)\)", README)
    assert pictures
    for picture in pictures:
        assert (ROOT / picture).stat().st_size < 500_000


def test_citation_has_the_version():
    assert f"version: {jaxscp.__version__}\n" in (ROOT / "CITATION.cff").read_text()
