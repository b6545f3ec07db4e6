"""The file of ``jaxscp sweep``: a wrong value is refused in one line, which names the file and the key."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

import jaxscp.monte_carlo as mc
from jaxscp.cli import app as cli
from jaxscp.cli.sweep_config import read_config

LANDING = """
[sweep]
case = "ascend"
mode = "paper"
nodes = 20
count = 8
seed = 3
keep = "failures"

[[parameter]]
leaf = "airframe.body.mass"
name = "mass"
unit = "kg"
normal = { mean = 0.928, deviation = 0.03 }

[[parameter]]
leaf = "goal.position"
name = "goal_x"
index = 0
change = "add"
scipy = { name = "triang", c = 0.5, loc = -0.1, scale = 0.2 }

[[correlation]]
between = ["mass", "goal_x"]
value = 0.5

[stop]
share_width = 0.05
"""
STOP = "share_width = 0.05"
SCIPY = '{ name = "triang", c = 0.5, loc = -0.1, scale = 0.2 }'
NORMAL = "normal = { mean = 0.928, deviation = 0.03 }"
COUNT = "count = 8\nseed = 3"
GRID = COUNT, 'sampling = "grid"\npoints = '
BETWEEN = 'between = ["mass", "goal_x"]'
OF_A_FILE = '[sweep]\nstudy = "st.py:make"\n'


def invoke(*arguments):
    return CliRunner(env={"COLUMNS": "120", "NO_COLOR": "1"}).invoke(cli.app, ["sweep", *map(str, arguments)])


def test_a_landing(tmp_path):
    (tmp_path / "landing.toml").write_text(LANDING)
    found = read_config(tmp_path / "landing.toml")
    assert found.study.names == ("mass", "goal_x")
    assert found.study.count == 8
    assert found.keep == mc.FailedTrajectories()
    assert found.stop == (mc.NarrowShare(0.05),)
    values = found.study.values(np.arange(8))
    case = found.study.case(5)
    assert float(case.airframe.body.mass) == values[5, 0]
    assert float(case.goal.position[0] - found.study.base.goal.position[0]) == pytest.approx(values[5, 1])


def test_all_choices_of_a_file(tmp_path):
    """The rarer keys, and whole numbers where a number may have a fraction."""
    text = LANDING.replace(*GRID, 1).replace("points = ", "points = [2, 3]").replace(BETWEEN, "")
    text = text.replace("[[correlation]]", "").replace("value = 0.5", "")
    text = text.replace('keep = "failures"', "keep = { every = 2 }").replace("index = 0", "index = [0]")
    text = text.replace(NORMAL, "choice = { values = [1, 2], weights = [1, 3] }")
    text = text.replace(STOP, 'mean_of = "cost"\nmean_width = 1\nseconds = 60')
    (tmp_path / "landing.toml").write_bytes(b"\xef\xbb\xbf" + text.encode())  # some editors write this mark
    found = read_config(tmp_path / "landing.toml")
    assert found.study.count == 6
    assert found.keep == mc.EveryNth(2)
    assert found.stop == (mc.NarrowMean("cost", 1, 0.95), mc.Budget(60))
    assert found.study.parameters[0].distribution == mc.Choice((1, 2), (1, 3))
    assert (found.chunk, found.workers, found.folder) == (100, 1, "landing_results")


@pytest.mark.slow
def test_a_landing_runs(tmp_path):
    (tmp_path / "landing.toml").write_text(LANDING)
    result = invoke(tmp_path / "landing.toml", "--json", "--folder", tmp_path / "r")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout.splitlines()[-1])["statuses"]["converged"] == 8


def refused(file):
    """The message, which is one line and begins with the file."""
    with pytest.raises(ValueError) as caught:  # noqa: PT011, each caller looks at the message
        read_config(file)
    text = str(caught.value)
    assert text.startswith(f"{file}: ")
    assert "\n" not in text
    return text.removeprefix(f"{file}: ")


WRONG = [
    # tables
    ("[sweep]", "sweep = 3\n[other]", "unknown table [other]; known are [sweep], [[parameter]]"),
    ("[stop]", "[stops]", "unknown table [stops]"),
    ("[[parameter]]", "[parameter]", "expected TOML, text in UTF-8: Cannot overwrite a value (at line 16"),
    (
        "[[correlation]]",
        "[correlation]",
        "[correlation]: expected a list of tables, got one table; write [[correl",
    ),
    ("[sweep]", "[sweep", "expected TOML, text in UTF-8: "),
    # keys
    ("seed = 3", "sed = 3", "[sweep]: unknown key 'sed'; known are folder, keep, chunk"),
    (STOP, "share = 1", "[stop]: unknown key 'share'; known are share_width, seconds"),
    ("count = 8", "", "[sweep] count: is missing; expected a whole number, 1 or more; the table has seed"),
    ('unit = "kg"', "units = 3", "[[parameter]] 1: unknown key 'units'; known are normal, leaf, index"),
    (BETWEEN, "", "[[correlation]] 1 between: is missing; expected a list of two names; the table has value"),
    # text and choices
    ('case = "ascend"', 'case = "moon"', "[sweep] case: expected one of platform, ascend, got 'moon'"),
    ('case = "ascend"', "case = 4", "[sweep] case: expected one of platform, ascend, got 4"),
    ('case = "ascend"', "scenario = 4", "[sweep] scenario: expected text in quotes, not empty, got 4"),
    ('case = "ascend"', 'scenario = "none.npz"', "[sweep] scenario: [Errno 2] No such file"),
    ('case = "ascend"', 'scenario = "landing.toml"', "[sweep] scenario: "),
    ('case = "ascend"', "study = 4", "[sweep] study: expected text in quotes, not empty, got 4"),
    ('mode = "paper"', "mode = true", "[sweep] mode: expected one of default, paper, proximal, got True"),
    ("[sweep]", "[sweep]\nfolder = 3", "[sweep] folder: expected text in quotes, not empty, got 3"),
    ('name = "mass"', "name = 3", "[[parameter]] 1 name: expected text in quotes, not empty, got 3"),
    ('unit = "kg"', "unit = 3", "[[parameter]] 1 unit: expected text in quotes, got 3"),
    (
        'change = "add"',
        'change = "sub"',
        "[[parameter]] 2 change: expected one of set, add, scale, got 'sub'",
    ),
    (
        "index = 0",
        'index = "0"',
        "[[parameter]] 2 index: expected a whole number, or a list of them, got '0'",
    ),
    ("index = 0", "index = [true]", "[[parameter]] 2 index: expected a whole number, or a list of them"),
    ("airframe.body.mass", "airframe.mass", "parameter 'airframe.mass': the base has no such leaf"),
    # numbers
    ("nodes = 20", 'nodes = "many"', "[sweep] nodes: expected a whole number, 2 or more, got 'many'"),
    ("nodes = 20", "nodes = -1", "[sweep] nodes: expected a whole number, 2 or more, got -1"),
    ("nodes = 20", "nodes = 30.0", "[sweep] nodes: expected a whole number, 2 or more, got 30.0"),
    ("count = 8", "count = true", "[sweep] count: expected a whole number, 1 or more, got True"),
    ("count = 8", "count = 0", "[sweep] count: expected a whole number, 1 or more, got 0"),
    ("seed = 3", "seed = -3", "[sweep] seed: expected a whole number, 0 or more, got -3"),
    ("seed = 3", f"seed = {2**200}", "[sweep] seed: expected a whole number, 0 or more, got 16069"),
    ("seed = 3", "workers = true", "[sweep] workers: expected a whole number, 1 or more, got True"),
    ("seed = 3", "chunk = 1.5", "[sweep] chunk: expected a whole number, 1 or more, got 1.5"),
    (*GRID, "[sweep] points: expected a list; each value: a whole number, 1 or more, got 3", "3"),
    (*GRID, "[sweep] points: expected a list; each value: a whole number, 1 or more, got ['a']", '["a"]'),
    (*GRID, "[sweep] points: expected a list; each value: a whole number, 1 or more, got []", "[]"),
    ('"failures"', '{ every = "a" }', "[sweep] keep.every: expected a whole number, 1 or more, got 'a'"),
    (
        '"failures"',
        "{ each = 2 }",
        "[sweep] keep.every: is missing; expected a whole number, 1 or more; the table",
    ),
    (
        '"failures"',
        '"some"',
        "[sweep] keep: expected one of none, all, failures, { every = NUMBER }, got 'some'",
    ),
    (STOP, 'seconds = "a"', "[stop] seconds: expected a positive number, got 'a'"),
    (STOP, "seconds = -1", "[stop] seconds: expected a positive number, got -1"),
    (STOP, 'share_width = "a"', "[stop] share_width: expected a positive number, got 'a'"),
    (STOP, "share_width = 0.0", "[stop] share_width: expected a positive number, got 0.0"),
    (STOP, "share_width = nan", "[stop] share_width: expected a positive number, got nan"),
    (STOP, "mean_width = 1.0", "[stop] mean_of: is missing; expected text in quotes, not empty"),
    (STOP, 'mean_of = "cost"', "[stop] mean_width: is missing; expected a positive number"),
    (STOP, "confidence = 1", "[stop] confidence: expected a number from 0.5, below 1, got 1"),
    # correlations
    (BETWEEN, "between = 1", "[[correlation]] 1 between: expected a list of two names, got 1"),
    (
        BETWEEN,
        "between = [[1], [2]]",
        "[[correlation]] 1 between: expected a list of two names, got [[1], [2]]",
    ),
    (BETWEEN, 'between = ["mass", "x"]', "correlations: no parameter is called 'x'; there are mass, goal_x"),
    ("value = 0.5", "value = 2", "[[correlation]] 1 value: expected a number between -1 and 1, got 2"),
    # distributions
    (
        "normal = {",
        "gauss = {",
        "[[parameter]] 1: give one of uniform, log_uniform, normal, choice, scipy, got none",
    ),
    (NORMAL, "normal = 3", "[[parameter]] 1 normal: expected a table, got 3"),
    (
        "deviation",
        "width",
        "[[parameter]] 1 normal.deviation: is missing; expected a number; the table has width",
    ),
    ("0.928", '"heavy"', "[[parameter]] 1 normal.mean: expected a number, got 'heavy'"),
    ("0.03 }", "0.03, upper = nan }", "[[parameter]] 1 normal.upper: expected a number or inf, got nan"),
    (
        "deviation = 0.03",
        "deviation = -1",
        "[[parameter]] 1 normal: Normal: needs a finite mean and a positive",
    ),
    (
        NORMAL,
        'choice = { values = ["a", "b"] }',
        "[[parameter]] 1 choice.values: expected a list; each value: a num",
    ),
    (
        NORMAL,
        "choice = { values = 3 }",
        "[[parameter]] 1 choice.values: expected a list; each value: a number, got 3",
    ),
    # SciPy's: its test suite among names, shapes that are unknown, missing or outside of their range
    (
        SCIPY,
        '{ name = "test" }',
        "[[parameter]] 2 scipy.name: expected a distribution of scipy.stats, gamma or triang",
    ),
    (SCIPY, '{ name = "ttest_ind" }', "say, got 'ttest_ind'"),
    (SCIPY, "{ name = 3 }", "[[parameter]] 2 scipy.name: expected a distribution of scipy.stats"),
    (
        "c = 0.5",
        "d = 0.5",
        "[[parameter]] 2 scipy.c: is missing; expected a number; the table has d, loc, scale",
    ),
    ("c = 0.5", "c = 0.5, d = 1", "[[parameter]] 2 scipy: unknown key 'd'; known are name, c, loc, scale"),
    ("c = 0.5", "c = 2", "[[parameter]] 2 scipy: SciPy: scipy.stats.triang has no values for c = 2, loc"),
    ("c = 0.5", 'c = "a"', "[[parameter]] 2 scipy.c: expected a number, got 'a'"),
    (SCIPY, '{ name = "poisson_binom", p = 0.5 }', "[[parameter]] 2 scipy: "),
]


@pytest.mark.parametrize("change", WRONG, ids=lambda change: f"{change[1]}{''.join(change[3:])}".strip())
def test_wrong_values_name_the_file_and_the_key(tmp_path, change):
    old, new, message, *rest = change
    assert old in LANDING
    (tmp_path / "landing.toml").write_text(LANDING.replace(old, new + "".join(rest), 1))
    assert message in refused(tmp_path / "landing.toml")


@pytest.mark.parametrize("name", ["sweep", "stop", "parameter", "correlation"])
@pytest.mark.parametrize("value", ["3", "[1, 2]", '"a"', "{ x = 1 }", "[{ x = 1 }]", "[]", "2020-01-01"])
def test_a_table_of_another_type(tmp_path, name, value):
    file = tmp_path / "landing.toml"
    file.write_text(
        f"{name} = {value}\n" + ("" if name == "sweep" else '[sweep]\ncase = "ascend"\ncount = 2\n')
    )
    text = refused(file)
    assert (
        name in text or (name, value) in [("correlation", "[]")] or text.startswith("[[parameter]]: nothing")
    )


def test_one_table_in_place_of_a_list(tmp_path):
    (tmp_path / "a.toml").write_text(
        '[sweep]\ncase = "ascend"\ncount = 2\n[parameter]\nleaf = "cone_angle"\n'
    )
    assert (
        refused(tmp_path / "a.toml")
        == "[parameter]: expected a list of tables, got one table; write [[parameter]]"
    )


@pytest.mark.parametrize("content", [b"\xff\xfe[sweep]", b"[sweep]\nfolder = '\xe9'", b"a = " + b"[" * 5000])
def test_a_file_that_is_no_text_or_too_deep(tmp_path, content):
    (tmp_path / "a.toml").write_bytes(content)
    assert refused(tmp_path / "a.toml").startswith("expected TOML, text in UTF-8: ")


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("x = 1\n1 / 0\n", "st.py, line 2: ZeroDivisionError: division by zero"),
        ("def make(:\n", "st.py: SyntaxError: "),
        ("import no_such_package\n", "st.py, line 1: ModuleNotFoundError: No module named 'no_such_package'"),
        ("raise SystemExit(3)\n", "st.py, line 1: SystemExit: 3"),
        ("def make():\n    raise KeyError('mass')\n", "st.py, line 2: KeyError: 'mass'"),
        ("raise ValueError('two\\nlines')\n", "st.py, line 1: ValueError: two lines"),
        ("def make(a):\n    pass\n", "st.py: TypeError: make() missing 1 required positional argument: 'a'"),
        ("x = 1\n", "st.py: ValueError: there is no make"),
        ("make = 3\n", "make of st.py gives a int, not a Study"),
        ("\0", "st.py: "),
    ],
)
def test_a_study_file_that_fails(tmp_path, code, message):
    (tmp_path / "st.py").write_text(code)
    (tmp_path / "own.toml").write_text(OF_A_FILE)
    assert refused(tmp_path / "own.toml").startswith(f"[sweep] study: {message}")


def test_a_study_of_a_file_has_its_parameters(tmp_path):
    (tmp_path / "own.toml").write_text(OF_A_FILE + "[[parameter]]\nleaf = 'x'\n")
    assert "write no [[parameter]] or [[correlation]]" in refused(tmp_path / "own.toml")
    (tmp_path / "own.toml").write_text('[sweep]\nstudy = "no.py:make"\n')
    assert 'expected "FILE.py:NAME" of a file beside this one' in refused(tmp_path / "own.toml")


def test_the_command_ends_with_the_message_and_exit_code_2(tmp_path):
    file = tmp_path / "landing.toml"
    file.write_text(LANDING.replace("nodes = 20", "nodes = -1"))
    result = invoke(file, "--json")
    assert result.exit_code == 2
    assert json.loads(result.stdout) == {
        "status": "invalid_request",
        "message": f"{file}: [sweep] nodes: expected a whole number, 2 or more, got -1",
    }
    assert invoke(tmp_path / "none.toml").exit_code == 2
