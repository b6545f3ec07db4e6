"""The command line on few nodes; the tests share one compiled plan."""

import inspect
import json
import math
import subprocess
import sys

import equinox as eqx
import jax
import numpy as np
import pytest
from typer.models import OptionInfo
from typer.testing import CliRunner

import jaxscp
from jaxscp import Status, Trajectory
from jaxscp.backends import libraries
from jaxscp.cli import app as cli
from jaxscp.cli import report, requests, start

# N, 1e-5 of the range: limits hold to the conic solver's accuracy, which differs by processor.
THRUST = 5e-5

NODES = 20
# The paper's mode compiles in a fifth of the time; the slow tests run every mode.
MODE = "paper"
ENDS = ["--start", "-3", "0", "1", "--goal", "3", "0", "1"]
RUN = ["plan", "ascend", "--nodes", str(NODES), "--mode", MODE]


def invoke(*arguments):
    return CliRunner(env={"COLUMNS": "120", "NO_COLOR": "1"}).invoke(cli.app, [*map(str, arguments)])


@pytest.fixture(scope="module")
def answer(tmp_path_factory):
    """One run of the command with all outputs."""
    folder = tmp_path_factory.mktemp("plan")
    files = "--save", folder / "plan.npz", "--csv", folder / "plan.csv", "--plot", folder / "plan.png"
    result = invoke(*RUN, "--json", *files)
    return result, folder


@pytest.fixture(scope="module")
def facts(answer):
    return json.loads(answer[0].stdout)


def test_a_converged_plan_exits_zero(answer):
    result, _ = answer
    assert result.exit_code == 0, result.output
    assert result.exception is None or isinstance(result.exception, SystemExit)


def test_it_says_which_files_it_wrote(answer):
    result, folder = answer
    told = " ".join(result.stderr.split("wrote ")[1].split())
    assert told == ", ".join(str(folder / f"plan.{kind}") for kind in ("npz", "csv", "png"))


def test_options_whose_placeholder_is_their_name_state_it():
    """Typer 0.27 takes such a placeholder for the name, so that ``--mass`` became ``--MASS``."""
    commands = [c.callback for c in cli.app.registered_commands]
    parameters = [p for c in commands for p in inspect.signature(c).parameters.values()]
    options = {p.name: o for p in parameters for o in getattr(p.annotation, "__metadata__", ())}
    alike = {
        name: f"--{name}"
        in (option.default, *option.param_decls)  # Annotated options keep their flag as a default
        for name, option in options.items()
        if isinstance(option, OptionInfo) and (option.metavar or "").lower() == name
    }
    assert alike == {"mass": True, "speed": True}


def test_json_is_one_object_on_one_line(answer):
    assert answer[0].stdout.count("\n") == 1


def test_json_names_what_was_asked_and_what_came_of_it(facts):
    assert (facts["case"], facts["mode"], facts["nodes"]) == ("ascend", MODE, NODES)
    assert facts["status"] == "converged"
    assert facts["iterations"] == len(facts["history"]) >= 1
    assert facts["solve_seconds"] > 0.0
    assert facts["compile_seconds"] >= 0.0
    assert 0.0 <= facts["defect"] < 1e-2
    assert facts["violation"] >= 0.0
    assert facts["violation"] == max(c["between_nodes"] for c in facts["constraints"].values())


_NONE = ("optimality", "clearance", "info")  # the paper's mode claims no optimum; a case knows no obstacle


def test_json_numbers_are_finite(facts):
    def numbers(value):
        if isinstance(value, dict):
            value = list(value.values())
        if isinstance(value, list):
            for item in value:
                yield from numbers(item)
        elif not isinstance(value, str):
            yield value

    assert [facts[name] for name in _NONE[:2]] == [None, None]
    values = list(numbers({name: value for name, value in facts.items() if name not in _NONE}))
    assert len(values) > 10
    assert all(isinstance(v, int | float) and math.isfinite(v) for v in values)


def test_history_ends_at_the_plan(facts):
    rows = facts["history"]
    assert [row["iteration"] for row in rows] == list(range(1, len(rows) + 1))
    assert {"cost", "final_time", "virtual_control", "step_norm", "defect"} <= set(rows[-1])
    assert rows[-1]["final_time"] == pytest.approx(facts["final_time"], rel=1e-9)


def test_saved_trajectory_is_the_plan_in_si_units(answer, facts):
    with np.load(answer[1] / "plan.npz") as archive:
        shapes = {name: archive[name].shape for name in archive.files}
    assert shapes == {"time": (NODES,), "state": (NODES, 13), "control": (NODES, 4), "dilation": (NODES,)}
    path = Trajectory.load(answer[1] / "plan.npz")
    scenario = cli.CASES["ascend"]()
    assert float(path.time[-1]) == pytest.approx(facts["final_time"])
    np.testing.assert_allclose(path.state[0], scenario.start.vector(), atol=1e-6)
    np.testing.assert_allclose(path.state[-1, :3], scenario.goal.position, atol=1e-3)


def test_table_is_the_flight(answer, facts):
    with (answer[1] / "plan.csv").open() as file:
        names = file.readline().strip().split(",")
    rows = np.loadtxt(answer[1] / "plan.csv", delimiter=",", skiprows=1)
    assert names[:2] == ["time [s]", "x [m]"]
    assert rows.shape[1] == len(names)
    np.testing.assert_allclose(np.diff(rows[:-1, 0]), 1.0 / requests.RATE, rtol=1e-9)
    assert rows[0, 0] == 0.0
    assert rows[-1, 0] == facts["final_time"]


def test_ctrl_c_during_imports_is_no_traceback(monkeypatch):
    def interrupted():
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "main", interrupted)
    with pytest.raises(SystemExit) as ended:
        start.main()
    assert ended.value.code == 130


def test_picture_is_a_png(answer):
    assert (answer[1] / "plan.png").read_bytes().startswith(b"\x89PNG")


def test_table_report_and_times_are_printed(answer, facts):
    result = invoke(*RUN)
    assert result.exit_code == 0
    for text in ("iteration", "cost", "final time", "|nu|", "|dz|", "defect", "Newton steps"):
        assert text in result.stdout
    assert f"{facts['history'][0]['cost']:.4f}" in result.stdout
    for text in (
        "status: converged",
        "final position",
        "corridor",
        "ms a plan once compiled",
        "s to compile",
    ):
        assert text in result.stdout


def test_plan_that_did_not_converge_is_printed_and_exits_one(answer, monkeypatch):
    solution, timing = report.timed(cli.MODES[MODE](NODES), cli.CASES["ascend"]())
    unfinished = eqx.tree_at(lambda s: s.status, solution, Status.iteration_limit)
    monkeypatch.setattr(cli, "timed", lambda planner, scenario: (unfinished, timing))
    table, objects = invoke(*RUN), invoke(*RUN, "--json")
    assert (table.exit_code, objects.exit_code) == (1, 1)
    assert "status: iteration_limit" in table.stdout
    assert "Allow more iterations" in table.stdout
    assert json.loads(objects.stdout)["status"] == "iteration_limit"


def test_numbers_that_json_cannot_hold_become_null():
    assert [report.plain(v) for v in (np.float64(np.nan), jax.numpy.inf, np.int64(3))] == [None, None, 3]


@pytest.fixture(scope="module")
def wall(tmp_path_factory):
    """File of a point cloud: a wall at x = 0, 6 m wide and 5 m high, with a window of 2 m."""
    y, z = np.meshgrid(np.arange(-3.0, 3.0, 0.1), np.arange(0.0, 5.0, 0.1))
    points = np.stack([np.zeros(y.size), y.ravel(), z.ravel()], axis=1)
    window = (np.abs(points[:, 1]) < 1.0) & (np.abs(points[:, 2] - 2.0) < 1.0)
    file = tmp_path_factory.mktemp("maps") / "wall.npy"
    np.save(file, points[~window])
    return file


@pytest.mark.slow
def test_a_cloud_is_flown_through(wall, tmp_path):
    limits = ["--lower", "-5", "-3", "0.2", "--upper", "5", "3", "4.8"]
    drawn = ["--json", "--plot", tmp_path / "wall.png", "--save", tmp_path / "wall.npz"]
    result = invoke("plan", "--cloud", wall, *ENDS, *limits, "--nodes", NODES, "--mode", MODE, *drawn)
    assert result.exit_code == 0, result.output
    facts = json.loads(result.stdout)
    assert (facts["case"], facts["status"]) == ("wall.npy", "converged")
    assert facts["clearance"] > 0.0
    positions = np.asarray(Trajectory.load(tmp_path / "wall.npz").state[:, :3])
    np.testing.assert_allclose(positions[[0, -1]], [[-3.0, 0.0, 1.0], [3.0, 0.0, 1.0]], atol=1e-3)
    assert np.linalg.norm(positions[:, None] - np.load(wall)[None], axis=2).min() > 0.25


def test_no_way_through_a_cloud_is_said_and_exits_one(wall):
    pytest.importorskip("skimage", reason="needs the extra clouds")
    # The wall reaches beyond these limits on every side of its window.
    closed = ["--lower", "-5", "-2.8", "3.2", "--upper", "5", "2.8", "4.8"]
    above = ["--start", "-3", "0", "4", "--goal", "3", "0", "4"]
    result = invoke("plan", "--cloud", wall, *above, *closed, "--json")
    assert result.exit_code == 1
    facts = json.loads(result.stdout)
    assert facts["status"] == "no_corridor"
    assert "no route" in facts["message"]


def test_a_start_on_an_obstacle_is_refused(wall):
    limits = ["--lower", "-5", "-3", "0.2", "--upper", "5", "3", "4.8"]
    on_it = ["plan", "--cloud", wall, "--start", "0.1", "2", "2", "--goal", "3", "0", "1", *limits]
    result = invoke(*on_it)
    assert result.exit_code == 2
    assert "m from the nearest obstacle point" in " ".join(result.stderr.replace("│", " ").split())


@pytest.fixture
def never_compiles(monkeypatch):
    def refuse(planner, scenario):
        raise AssertionError("a bad request got as far as planning")

    monkeypatch.setattr(cli, "timed", refuse)


@pytest.mark.usefixtures("never_compiles")
@pytest.mark.parametrize(
    ("arguments", "explanation"),
    [
        (["plan"], "name a case (platform, ascend), or give --cloud, --start and --goal"),
        (["plan", "ascend", "--start", "0", "0", "1"], "go with --cloud: --start"),
        (["plan", "ascend", "--radius", "0.3"], "go with --cloud"),
        (["plan", "--cloud", "none.pcd", "--start", "0", "0", "1"], "--cloud needs --start and --goal"),
        (["plan", "--cloud", "none.pcd", *ENDS], "no such file: none.pcd"),
        (["plan", "sideways"], "no case is called 'sideways'; choose from platform, ascend"),
        (["plan", "ascend", "--mode", "magic"], "no mode is called 'magic'"),
        (["plan", "ascend", "--nodes", "1"], "greater than or equal to 2"),
        (["plan", "ascend", "--nodes", "many"], "'--nodes'"),
        (["plan", "platform", "--nodes", "4"], "5 polytopes need at least 6 nodes"),
        (["plan", "platform", "--mass", "40"], "the rotors cannot carry the weight"),
        (["plan", "platform", "--mass", "-1"], "must be positive"),
        (["plan", "platform", "--speed", "nan"], "needs finite numbers"),
        (["plan", "ascend", "--save", "no/such/folder/plan.npz"], "No such file or directory"),
        (["plan", "ascend", "--save", "."], "cannot write ."),
        (["plan", "ascend", "--plot", "no/such/folder/plan.png"], "No such file or directory"),
        (["plan", "ascend", "--plot", "plan.docx"], "plan.docx is no picture"),
        (["plan", "ascend", "--hurry"], "--hurry"),
    ],
)
def test_bad_request_exits_two_and_says_why(arguments, explanation):
    result = invoke(*arguments)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert explanation in " ".join(result.stderr.replace("│", " ").split())


@pytest.mark.usefixtures("never_compiles")
def test_checking_a_file_leaves_none_behind_and_harms_none(tmp_path):
    kept = tmp_path / "kept.npz"
    kept.write_bytes(b"precious")
    for name in ("fresh.npz", "kept.npz"):
        invoke("plan", "platform", "--nodes", "4", "--save", tmp_path / name)
    assert [file.name for file in tmp_path.iterdir()] == ["kept.npz"]
    assert kept.read_bytes() == b"precious"


def test_installation_is_described():
    facts = json.loads(invoke("info", "--json").stdout)
    assert facts["version"] == jaxscp.__version__
    assert facts["jax"] == jax.__version__
    assert len(facts["devices"]) == len(jax.devices())
    assert set(facts["libraries"]) == {library.stem.name for library in libraries.EVERY}
    for library in facts["libraries"].values():
        assert library["serves"] or library["reason"]
    assert jaxscp.__version__ in invoke("info").stdout
    assert invoke("--version").stdout == f"jaxscp {jaxscp.__version__}\n"


def test_mass_speed_and_time_weight_change_the_scenario():
    request = requests.PlanRequest(mass=1.1, speed=3.0, time_weight=5.0)
    changed = request.changed(cli.CASES["ascend"]())
    changed.check(NODES)
    assert float(changed.airframe.body.mass) == 1.1
    assert float(changed.limits.speed) == 3.0
    assert float(changed.weights.time) == 5.0


def test_runs_as_a_module():
    command = [sys.executable, "-m", "jaxscp", "plan", "--help"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    for option in ("--mode", "--nodes", "--save", "--plot", "--json"):
        assert option in result.stdout


@pytest.mark.slow
@pytest.mark.parametrize("mode", list(cli.MODES))
@pytest.mark.parametrize("case", list(cli.CASES))
def test_every_mode_plans_every_case(case, mode):
    result = invoke("plan", case, "--mode", mode, "--json")
    facts = json.loads(result.stdout)
    assert facts["status"] in ("converged", "iteration_limit")
    assert facts["constraints"]["thrust"]["between_nodes"] < THRUST
    assert facts["end_error"]["position"] < 0.01


def test_a_cache_is_used_only_where_one_is_named(monkeypatch, tmp_path):
    folders = []
    monkeypatch.setattr(requests, "use_cache", folders.append)
    too_few = ("plan", "ascend", "--nodes", 3)  # ends before any compilation
    assert invoke(*too_few).exit_code == 2
    assert folders == []
    assert invoke(*too_few, "--cache", tmp_path).exit_code == 2
    assert folders == [tmp_path]


def test_a_cache_that_cannot_be_made_is_a_wrong_request(tmp_path):
    (tmp_path / "taken").write_text("")
    result = invoke(*RUN, "--cache", tmp_path / "taken")
    assert result.exit_code == 2
    assert "cannot make" in result.output
