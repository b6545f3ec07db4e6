"""The command ``sweep``: configurations, answers, and wrong requests. Cases are cheap functions, not plans."""

import json
import os
import sys

import pytest
from typer.testing import CliRunner

from jaxscp.cli import app as cli

OWN = """
from jaxscp import monte_carlo as mc

def run(case):
    return {"success": case["x"] > 0.2, "cost": case["x"] + case["y"]}

def make():
    parameters = (mc.Parameter("x", mc.Uniform(0, 1)), mc.Parameter("y", mc.Normal(0, 1)))
    return mc.Study(run, {"x": 0.0, "y": 0.0}, parameters, mc.Independent(60, 1))
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
    assert [event["event"] for event in events] == ["message"] + ["progress"] * 3 + ["summary"]
    assert events[0]["text"] == "60 cases: starting, results follow ..."
    assert events[3]["done"] == events[3]["total"] == events[4]["cases"] == 60
    again = invoke(own, "--json").stdout.splitlines()
    assert json.loads(again[-1]) == events[-1]
    assert len(again) == 1


def test_a_report_needs_no_other_file(own, tmp_path):
    assert invoke(own, "--report", tmp_path / "report.html").exit_code == 0
    text = (tmp_path / "report.html").read_text()
    assert text.count("data:image/png;base64,") >= 4
    assert 'src="http' not in text


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


def test_a_rule_for_a_result_that_is_none_names_the_file_before_cases_run(own):
    own.write_text(own.read_text() + '[stop]\nmean_of = "height"\nmean_width = 1.0\n')
    result = invoke(own, "--json")
    assert result.exit_code == 2
    events = [json.loads(line) for line in result.stdout.splitlines()]
    assert "progress" not in [event.get("event") for event in events]
    assert f"{own}: stop: no result is called 'height'" in events[-1]["message"]
