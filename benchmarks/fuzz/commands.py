"""Command lines: each ends with exit code 0, 1 or 2, and one JSON object where that was asked for."""

import json
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from typer.testing import CliRunner

from benchmarks.fuzz.case import Case, Ending, any_of
from benchmarks.fuzz.places import hall
from jaxscp.cli.app import app

VALID = 0.4
PLAN = ("plan", "ascend", "--nodes", "12", "--mode", "paper", "--json")
PLACES = ("--start", "1", "0", "1", "--goal", "5", "0", "1")


def command(rng: np.random.Generator) -> Case:
    """A command that plans a stored case or reports a map; or a wrong one."""
    name = any_of(rng, WRONG, VALID)
    points = hall(rng)[0]

    def run() -> Ending:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "hall.npy"
            np.save(path, points)
            return _invoked(WRONG[name](str(path), rng) if name else _right(str(path), rng), not name)

    return Case("command", name, run)


def _right(path: str, rng: np.random.Generator) -> list[str]:
    if rng.random() < 0.5:
        return ["map", path, "--unit", "m", *PLACES, "--json"]
    mass, weight = rng.uniform(0.5, 1.3), rng.choice([0.0, 1.0, 20.0])
    return [*PLAN, "--mass", f"{mass:.3f}", "--time-weight", f"{weight}"]


def _invoked(arguments: list[str], valid: bool) -> Ending:
    found = CliRunner(env={"COLUMNS": "200", "NO_COLOR": "1"}).invoke(app, arguments)
    if found.exception is not None and not isinstance(found.exception, SystemExit):
        return Ending("traceback", f"{arguments}: {type(found.exception).__name__}: {found.exception}")
    if found.exit_code not in (0, 1, 2):
        return Ending("crash", f"{arguments}: exit code {found.exit_code}")
    try:
        told = json.loads(found.stdout)
    except ValueError:
        return Ending("traceback", f"{arguments}: stdout is no JSON: {found.stdout[:200]!r}")
    if found.exit_code == 2:
        said = bool(told.get("message"))
        return Ending("refused", told["message"]) if said else Ending("traceback", f"{arguments}: no message")
    if found.exit_code == 0:
        return Ending(
            "converged" if told["status"] == "converged" else "accepted" if valid else "read", told["status"]
        )
    return Ending(told["status"], told.get("cause") or told.get("message") or "")


def _number(rng: np.random.Generator) -> str:
    return str(rng.choice(["nan", "inf", "-1", "0", "1e400", "1e-400", "one", "", "-inf"]))


WRONG: dict[str, Callable[[str, np.random.Generator], list[str]]] = {
    "no such file": lambda p, r: ["map", p + "x", "--json"],
    "a folder": lambda p, r: ["map", str(Path(p).parent), "--json"],
    "a wrong unit": lambda p, r: ["map", p, "--unit", "yard", *PLACES, "--json"],
    "another unit": lambda p, r: ["map", p, "--unit", "mm", *PLACES, "--json"],
    "start alone": lambda p, r: ["map", p, "--start", "1", "0", "1", "--json"],
    "a wrong number": lambda p, r: ["map", p, "--radius", _number(r), "--json"],
    "a wrong place": lambda p, r: [
        "map",
        p,
        "--start",
        "1",
        "0",
        _number(r),
        "--goal",
        "5",
        "0",
        "1",
        "--json",
    ],
    "an unknown option": lambda p, r: ["map", p, "--colour", "red", "--json"],
    "no command": lambda p, r: ["fly", p, "--json"],
    "no case": lambda p, r: ["plan", "land", "--json"],
    "no mode": lambda p, r: ["plan", "ascend", "--mode", "fast", "--json"],
    "one node": lambda p, r: ["plan", "ascend", "--nodes", str(r.integers(-3, 3)), "--json"],
    "a wrong mass": lambda p, r: [*PLAN, "--mass", _number(r)],
    "a heavy vehicle": lambda p, r: [*PLAN, "--mass", str(10.0 ** r.uniform(0.5, 6))],
    "a wrong weight": lambda p, r: [*PLAN, "--time-weight", _number(r)],
    "start outside the map": lambda p, r: [
        "plan",
        "--cloud",
        p,
        "--start",
        "-99",
        "0",
        "1",
        *PLACES[4:],
        "--json",
    ],
    "start in a wall": lambda p, r: [
        "plan",
        "--cloud",
        p,
        "--start",
        "0.01",
        "0",
        "1",
        *PLACES[4:],
        "--json",
    ],
    "goal is the start": lambda p, r: [
        "plan",
        "--cloud",
        p,
        "--start",
        "0",
        "0",
        "0",
        "--goal",
        "0",
        "0",
        "0",
        "--json",
    ],
    "map and case": lambda p, r: ["plan", "ascend", "--cloud", p, *PLACES, "--json"],
    "limits swapped": lambda p, r: [
        *("plan", "--cloud", p, *PLACES, "--lower", "9", "9", "9", "--upper", "0", "0", "0", "--json")
    ],
    "a folder that cannot be written": lambda p, r: [*PLAN, "--save", "/nowhere/plan.npz"],
}
