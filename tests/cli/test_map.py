"""The command ``map``, options that state the meaning of a map's file, and endings of wrong requests."""

import ast
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from jaxscp import corridor
from jaxscp.cli import app as cli
from jaxscp.corridor import FileLayout, read_cloud

HALL = ["--start", "0", "-1.5", "1.5", "--goal", "6", "-1.5", "1.2"]
KEYWORDS = {
    *(
        "unit",
        "frame",
        "offset",
        "columns",
        "spacing",
        "cell",
        "corner",
        "height",
        "lower",
        "upper",
        "clearance",
    ),
    *("radius", "remove"),
}
"""Arguments of Python that a message may name, and that the command line has under the same name or ``--crop``."""


def invoke(*arguments):
    return CliRunner(env={"COLUMNS": "200", "NO_COLOR": "1"}).invoke(cli.app, [*map(str, arguments)])


def text_of(result):
    """Text on stderr without its frame."""
    return " ".join(result.stderr.replace("│", " ").split())


def room(spacing=0.2):
    """Points on floor, ceiling and walls of a room of 8 x 6 x 3 m."""
    axes = [np.arange(low, high + 1e-9, spacing) for low, high in ((-1, 7), (-3, 3), (0, 3))]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    low, high = grid.min(axis=0), grid.max(axis=0)
    return grid[np.any((grid == low) | (grid == high), axis=1)]


@pytest.fixture
def write(tmp_path):
    """Write an array to a file of a name; gives its path."""

    def to(name, points):
        file = tmp_path / name
        if file.suffix == ".npy":
            np.save(file, points)
        else:
            np.savetxt(file, points)
        return file

    return to


@pytest.fixture
def built(monkeypatch):
    """The cloud and the arguments that a plan's corridor would be built from; nothing is planned."""
    calls = []

    def refuse(cloud, start, goal, radius, **options):
        calls.append((cloud, radius, options))
        raise ValueError("nothing is built in this test")

    monkeypatch.setattr(cli, "build_corridor", refuse)
    return calls


def test_a_sound_map_is_reported_and_exits_zero(write):
    result = invoke("map", write("room.npy", room()), *HALL)
    assert result.exit_code == 0, result.output
    for text in ("room.npy: 4502 points", "box (-1, -3, 0) to (7, 3, 3) m", "safety radius 0.25 m"):
        assert text in result.stdout
    assert "start in the box, goal in the box" in result.stdout
    assert "assumed: unit m" in result.stdout


def test_a_refused_map_exits_two_and_the_option_that_the_message_names_mends_it(write):
    file = write("room.npy", 1000.0 * room())
    refused, mended = invoke("map", file, *HALL), invoke("map", file, *HALL, "--unit", "mm")
    assert (refused.exit_code, mended.exit_code) == (2, 0)
    assert "refused: neighbouring points are 200 m" in refused.stdout
    assert "(--unit m)" in refused.stdout
    assert "8 x 6 x 3 m" in mended.stdout


def test_the_unit_is_judged_without_a_flight(write):
    assert invoke("map", write("room.npy", 1000.0 * room())).exit_code == 2


def test_the_report_is_one_json_object(write):
    file = write("room.npy", room() + np.array([100.0, 0.0, 0.0]))
    result = invoke("map", file, *HALL, "--json", "--radius", "0.3")
    facts = json.loads(result.stdout)
    assert result.exit_code == 2
    assert (facts["status"], facts["points"], facts["radius"]) == ("refused", 4502, 0.3)
    assert facts["inside"] == {"start": False, "goal": False}
    assert "--offset" in facts["message"]
    np.testing.assert_allclose(facts["upper"], [107, 3, 3])


def test_gaps_that_would_be_closed_are_named(write):
    result = invoke("map", write("room.npy", room(0.75)), "--unit", "m")
    assert result.exit_code == 0
    assert re.search(r"gaps of up to 1\.\d* m", result.stdout)


def test_the_picture_is_written_even_of_a_refused_map(write, tmp_path):
    picture = tmp_path / "room.png"
    assert invoke("map", write("room.npy", 1000.0 * room()), "--picture", picture).exit_code == 2
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "explanation"),
    [
        (["map"], "Missing argument 'FILE'"),
        (["map", "none.pcd"], "no such file: none.pcd"),
        (["map", "FILE", "--start", "0", "0", "1"], "--start and --goal go together"),
        (["map", "FILE", "--unit", "yard"], "no unit is called 'yard'; choose from m, dm"),
        (["map", "FILE", "--frame", "esd"], "no frame is called 'esd'; choose from enu"),
        (["map", "FILE", "--radius", "nan"], "greater than or equal to 0"),
        (["map", "FILE", "--radius", "inf"], "needs finite numbers, got inf"),
        (["map", "FILE", "--offset", "0", "inf", "0"], "needs finite numbers"),
        (["map", "FILE", "--spacing", "0"], "must be positive"),
        (["map", "FILE", "--picture", "map.docx"], "map.docx is no picture"),
        (["plan", "platform", "--unit", "mm"], "go with --cloud: --unit"),
        (["plan", "platform", "--clearance", "0.2"], "go with --cloud: --clearance"),
    ],
)
def test_a_wrong_request_exits_two_and_says_why_in_words_and_in_json(write, arguments, explanation):
    file = write("room.npy", room())
    arguments = [file if argument == "FILE" else argument for argument in arguments]
    words, objects = invoke(*arguments), invoke(*arguments, "--json")
    assert (words.exit_code, objects.exit_code) == (2, 2)
    assert words.stdout == ""
    assert explanation in text_of(words)
    facts = json.loads(objects.stdout)
    assert facts["status"] == "invalid_request"
    assert explanation in facts["message"]


def test_what_is_assumed_of_a_map_is_printed_before_a_plan(write, built):
    result = invoke("plan", "--cloud", write("room.npy", room()), *HALL)
    assert result.exit_code == 2
    assert "assumed: unit m" in result.stderr
    assert "nothing is built in this test" in text_of(result)
    assert len(built) == 1


def test_options_reach_the_reader_and_the_corridor(write, built):
    stored = 1000.0 * room() * [1, -1, -1]
    file = write("room.txt", np.column_stack([np.full(len(stored), 7.0), stored]))
    meaning = ["--unit", "mm", "--frame", "frd", "--columns", "1", "2", "3", "--offset", "1", "2", "3"]
    corridor_options = ["--radius", "0.3", "--clearance", "0.2", "--lower", "-1", "-3", "0", "--crop", "0.5"]
    invoke("plan", "--cloud", file, *HALL, *meaning, *corridor_options)
    cloud, radius, options = built[0]
    np.testing.assert_allclose(cloud.points, room() - np.array([1.0, 2.0, 3.0]), atol=1e-9)
    assert (radius, options["clearance"], options["lower"]) == (0.3, 0.2, (-1.0, -3.0, 0.0))
    assert len(options["remove"]) == 2


def test_an_occupancy_grid_is_read_by_its_options(write):
    grid = np.zeros((40, 30, 15), bool)
    grid[:, :, 0] = True
    file = write("grid.npy", grid)
    assert "(--cell 0.1)" in text_of(invoke("map", file))
    facts = json.loads(invoke("map", file, "--cell", "0.2", "--corner", "-1", "-3", "0", "--json").stdout)
    expected = read_cloud(file, layout=FileLayout(cell=0.2, corner=(-1.0, -3.0, 0.0))).extent
    np.testing.assert_allclose([facts["lower"], facts["upper"]], expected)


def test_columns_by_name_need_a_header(write):
    file = write("room.txt", room())
    assert "no header names its columns" in text_of(invoke("map", file, "--columns", "e", "n", "u"))
    assert "no column 9" in text_of(invoke("map", file, "--columns", "0", "1", "9"))


def test_a_platform_that_jax_cannot_use_is_a_wrong_request(monkeypatch):
    def none():
        raise AssertionError

    monkeypatch.setattr("jax.devices", none)
    result = invoke("plan", "platform", "--json")
    assert result.exit_code == 2
    assert "JAX cannot run on" in json.loads(result.stdout)["message"]


def messages():
    """Texts of the corridor's room that users may read: strings that are no docstrings, by file and line."""
    for file in sorted(Path(corridor.__file__).parent.glob("*.py")):
        tree = ast.parse(file.read_text())
        skipped = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        for joined in ast.walk(tree):
            if isinstance(joined, ast.JoinedStr):
                skipped |= {id(part) for part in joined.values}
        for node in ast.walk(tree):
            if id(node) in skipped:
                continue
            if isinstance(node, ast.JoinedStr):
                parts = [part.value if isinstance(part, ast.Constant) else "0" for part in node.values]
                yield f"{file.name}:{node.lineno}", "".join(map(str, parts))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield f"{file.name}:{node.lineno}", node.value


def options_of(command):
    """Names of a command's options."""
    return {name for option in command.params for name in option.opts if name.startswith("--")}


def test_messages_name_options_that_the_command_line_has():
    commands = typer.main.get_command(cli.app).commands
    known = options_of(commands["plan"])
    found = [(place, name) for place, text in messages() for name in re.findall(r"(?<![\w-])--[a-z-]+", text)]
    assert len(found) >= 20
    assert not [(place, name) for place, name in found if name not in known]
    # ``map`` reads files as ``plan`` does
    assert known - options_of(commands["map"]) <= {
        *("--crop", "--clearance", "--mode", "--nodes", "--cloud", "--save", "--csv", "--plot", "--cache"),
        *("--mass", "--speed", "--time-weight"),
    }


def test_a_message_that_names_an_argument_of_python_names_the_option_too():
    lacking = []
    for place, text in messages():
        for word in set(re.findall(r"\b([a-z]+)=", text)) & KEYWORDS:
            option = "--crop" if word == "remove" else f"--{word}"
            if option not in text:
                lacking.append((place, word))
    assert not lacking


def test_the_log_level_is_set_before_jax_is_imported():
    code = "import sys, os, jaxscp.cli.start; print('jax' in sys.modules)"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "False"
