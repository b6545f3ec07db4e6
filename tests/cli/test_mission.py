"""The command ``mission``: wrong requests at once, and one mission by night."""

import json

import pytest
from typer.testing import CliRunner

from jaxscp.cli import app as cli


def invoke(*arguments):
    return CliRunner(env={"COLUMNS": "120", "NO_COLOR": "1"}).invoke(
        cli.app, ["mission", *map(str, arguments)]
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["underwater"], "indoor"),
        (["indoor", "--wind", "nan"], "wind"),
        (["indoor", "--deck-speed", "3"], "deck-speed"),
        (["indoor", "--video", "flight.avi"], ".gif"),
        (["indoor", "--save", "no/such/folder/flight.npz"], "cannot write"),
    ],
)
def test_wrong_requests_end_with_2_and_name_the_option(arguments, message):
    result = invoke(*arguments)
    assert result.exit_code == 2
    assert message in result.output


def test_a_wrong_request_is_one_json_object():
    result = invoke("underwater", "--json")
    assert result.exit_code == 2
    assert json.loads(result.stdout.splitlines()[0])["status"] == "invalid_request"


@pytest.mark.nightly
def test_a_mission_writes_its_files(tmp_path):
    files = {kind: tmp_path / f"flight.{kind}" for kind in ("gif", "png", "npz")}
    options = ["--video", files["gif"], "--plot", files["png"], "--save", files["npz"], "--json"]
    result = invoke("indoor", "--seed", 1, "--deck-speed", 0.3, *options)
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout.splitlines()[-1])
    assert found["status"] == "landed"
    assert found["deck_speed"] == pytest.approx(0.3)
    assert all(file.stat().st_size > 1000 for file in files.values())
