"""The command ``sweep``: configurations, answers, and wrong requests. Cases are cheap functions, not plans."""

import json
import os
import sys

import numpy as np
import pytest
from typer.testing import CliRunner

import jaxscp.monte_carlo as mc
from jaxscp.cli import app as cli
from jaxscp.cli.sweep_config import read_config

OWN = """
from jaxscp import monte_carlo as mc

def run(case):
    return {"success": case["x"] > 0.2, "cost": case["x"] + case["y"]}

def make():
    parameters = (mc.Parameter("x", mc.Uniform(0, 1)), mc.Parameter("y", mc.Normal(0, 1)))
    return mc.Study(run, {"x": 0.0, "y": 0.0}, parameters, mc.Independent(60, 1))
"""
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


def invoke(*arguments):
    return CliRunner(env={"COLUMNS": "120", "NO_COLOR": "1"}).invoke(cli.app, ["sweep", *map(str, arguments)])


@pytest.fixture
def own(tmp_path):
    (tmp_path / "own.py").write_text(OWN)
    file = tmp_path / "own.toml"
    file.write_text(f'[sweep]\nstudy = "own.py:make"\nchunk = 20\nfolder = "{tmp_path / "results"}"\n')
    return file


def test_a_study_of_a_python_file(own, tmp_path):
    result = invoke(own, "--parquet", tmp_path / "t.parquet")
    assert result.exit_code == 0, result.output
    assert "60 cases; all cases are computed" in result.stdout
    assert "success: " in result.stdout
    import pandas

    assert len(pandas.read_parquet(tmp_path / "t.parquet")) == 60


def test_json_is_a_line_an_event(own):
    events = [json.loads(line) for line in invoke(own, "--json").stdout.splitlines()]
    assert [event["event"] for event in events] == ["progress"] * 3 + ["summary"]
    assert events[2]["done"] == events[2]["total"] == events[3]["cases"] == 60
    again = invoke(own, "--json").stdout.splitlines()
    assert json.loads(again[-1]) == events[-1]
    assert len(again) == 1


def test_a_report_needs_no_other_file(own, tmp_path):
    assert invoke(own, "--report", tmp_path / "report.html").exit_code == 0
    text = (tmp_path / "report.html").read_text()
    assert text.count("data:image/png;base64,") >= 4
    assert 'src="http' not in text


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


@pytest.mark.slow
def test_a_landing_runs(tmp_path):
    (tmp_path / "landing.toml").write_text(LANDING)
    result = invoke(tmp_path / "landing.toml", "--json", "--folder", tmp_path / "r")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout.splitlines()[-1])["statuses"]["converged"] == 8


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('case = "ascend"', 'case = "moon"', "choose from platform, ascend, got 'moon'"),
        ("count = 8", "", "count is missing"),
        ("seed = 3", "sed = 3", "unknown key 'sed'"),
        ("normal = {", "gauss = {", "give one of uniform"),
        ("deviation = 0.03", "width = 0.03", "[[parameter]] 1 normal: "),
        ("airframe.body.mass", "airframe.mass", "no such leaf"),
        ("share_width", "share", "unknown key 'share'"),
        ("[sweep]", "[sweep", "is no TOML"),
        ('keep = "failures"', 'keep = "some"', "choose from none, all, failures, got 'some'"),
    ],
)
def test_wrong_configurations_name_the_key(tmp_path, old, new, message):
    (tmp_path / "landing.toml").write_text(LANDING.replace(old, new))
    result = invoke(tmp_path / "landing.toml", "--json")
    assert result.exit_code == 2
    found = json.loads(result.stdout)
    assert found["status"] == "invalid_request"
    assert message in found["message"]


def test_another_study_in_the_folder(own, tmp_path, monkeypatch):
    """Even where the edited file has the size and the time of the old one, for which Python keeps bytecode."""
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    file = tmp_path / "own.py"
    before = file.stat()
    assert invoke(own).exit_code == 0
    file.write_text(OWN.replace("0.2", "0.3"))
    os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))
    result = invoke(own, "--json")
    assert result.exit_code == 2
    assert "holds another sweep" in json.loads(result.stdout)["message"]
