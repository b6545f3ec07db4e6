"""What a sweep tells before its first results, and after Ctrl-C."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from jaxscp import monte_carlo as mc
from jaxscp.monte_carlo import driver, storage

TIMEOUT = 60.0  # s, for a sweep that would not end


def study(run=lambda case: {"y": case["x"]}):
    parameters = (mc.Parameter("x", mc.Uniform(0, 1)),)
    return mc.Study(run, {"x": 0.0}, parameters, mc.Independent(20, 1))


def told(capsys, folder, how=mc.Lines, **more):
    mc.sweep(study(), folder, progress=how(), chunk=5, **more)
    return capsys.readouterr().err.splitlines()


def test_the_first_line_comes_before_any_case(tmp_path):
    seen = []

    class Told(mc.Silent):
        def message(self, text):
            seen.append(text)

    def run(case):
        seen.append("case")
        return {"y": case["x"]}

    mc.sweep(study(run), tmp_path / "s", progress=Told())
    assert seen[:2] == ["20 cases: starting, results follow ...", "case"]


def test_it_says_what_is_stored_and_nothing_of_a_finished_sweep(tmp_path, capsys):
    assert (
        told(capsys, tmp_path / "s", stop=(mc.Budget(1e-9),))[0] == "20 cases: starting, results follow ..."
    )
    again = told(capsys, tmp_path / "s", mc.JSONLines)
    assert json.loads(again[0]) == {
        "event": "message",
        "text": "20 cases, 5 of them stored: starting, results follow ...",
    }
    assert told(capsys, tmp_path / "s") == []


def test_planners_compile_first():
    import jaxscp

    base = jaxscp.scenarios.ascent_to_platform()
    parameters = (mc.Parameter("airframe.body.mass", mc.Uniform(0.9, 1.0)),)
    planned = mc.Study(jaxscp.Planner(), base, parameters, mc.Independent(8))
    assert driver._starting(planned, 0) == "8 cases: compiling first, results follow ..."


def test_a_bar_without_a_terminal_prints_lines_and_no_empty_one(tmp_path, capsys):
    mc.sweep(study(), tmp_path / "s", progress=mc.Bar())
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "20 cases: starting, results follow ..."
    assert "" not in lines


def test_a_rule_names_a_result_that_is_none_before_cases_run(tmp_path):
    calls = []

    def run(case):
        calls.append(case)
        return {"y": case["x"]}

    with pytest.raises(mc.InvalidStudy, match="no result is called 'z'; there are x, y"):
        mc.sweep(study(run), tmp_path / "s", stop=(mc.NarrowMean("z", 0.1),), chunk=1)
    assert len(calls) == 1  # the base, for names


def test_a_lock_file_that_was_left_behind_stops_nothing(tmp_path):
    mc.sweep(study(), tmp_path / "s", stop=(mc.Budget(1e-9),), chunk=5)
    (tmp_path / "s" / storage.LOCK).write_text("")
    assert mc.sweep(study(), tmp_path / "s").complete == 20


INTERRUPTED = """
import signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job inherits that it is ignored
import jax
from jaxscp import monte_carlo as mc

def run(case):
    if case["x"] != 0.0:  # all but the base
        time.sleep(1000.0)  # stands for a compilation, which signals do not reach
    return {"y": case["x"]}

if __name__ == "__main__":
    study = mc.Study(run, {"x": 0.0}, [mc.Parameter("x", mc.Uniform(1, 2))], mc.Independent(4, 1))
    try:
        mc.sweep(study, sys.argv[1], engine=mc.Processes(2), chunk=1, progress=mc.Lines())
    except KeyboardInterrupt:
        sys.exit(130)
"""


@pytest.mark.slow
@pytest.mark.parametrize("moment", ["configuration.json", storage.LOCK], ids=["cases run", "workers start"])
def test_ctrl_c_ends_busy_processes_at_once(tmp_path, moment):
    script = tmp_path / "script.py"
    script.write_text(INTERRUPTED)
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    driver = subprocess.Popen(
        [sys.executable, str(script), str(tmp_path / "s")],
        env=environment,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,  # a terminal sends Ctrl-C to all of a group
    )
    while not (tmp_path / "s" / moment).exists():
        assert driver.poll() is None
    os.killpg(driver.pid, signal.SIGINT)
    _, errors = driver.communicate(timeout=TIMEOUT)
    assert driver.returncode == 130
    assert "ended: 0 of 4 cases are stored" in errors
    assert "Traceback" not in errors
