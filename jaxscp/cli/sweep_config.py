"""The file of ``jaxscp sweep``: a TOML table with the study, its folder, and rules that end it."""

import importlib.util
import tomllib
from collections.abc import Callable
from importlib.machinery import SourceFileLoader
from pathlib import Path
from typing import Any, NamedTuple

import jaxscp.monte_carlo as mc
from jaxscp.cli.requests import CASES, MODES
from jaxscp.landing.scenario import LandingScenario

SAMPLERS: dict[str, Callable[..., Any]] = {
    "independent": mc.Independent,
    "latin_hypercube": mc.LatinHypercube,
    "sobol": mc.Sobol,
}
DISTRIBUTIONS: dict[str, Callable[..., Any]] = {
    "uniform": mc.Uniform,
    "log_uniform": mc.LogUniform,
    "normal": mc.Normal,
    "choice": lambda values, weights=None: mc.Choice(
        tuple(values), None if weights is None else tuple(weights)
    ),
    "scipy": lambda name, **numbers: _of_scipy(name, numbers),
}


def _of_scipy(name: str, numbers: dict[str, float]) -> mc.SciPy:
    import scipy.stats

    return mc.SciPy(getattr(scipy.stats, name)(**numbers))


class SweepConfig(NamedTuple):
    """Content of the file."""

    study: mc.Study
    folder: str
    keep: mc.Keep
    stop: tuple[mc.Stop, ...]
    chunk: int
    workers: int


def read_config(file: Path) -> SweepConfig:
    """Read a configuration.

    Raises:
        ValueError: if a key is unknown, missing or wrong; the message names it.
        OSError: if a file cannot be read.
    """
    try:
        tables = tomllib.loads(file.read_text())
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{file}: is no TOML: {error}") from error
    _only(tables, {"sweep", "parameter", "correlation", "stop"}, str(file))
    about = dict(tables.get("sweep", {}))
    folder = about.pop("folder", f"{file.stem}_results")
    keep = _keep(about.pop("keep", "none"))
    chunk, workers = about.pop("chunk", 100), about.pop("workers", 1)
    for name, value in (("chunk", chunk), ("workers", workers)):
        if not isinstance(value, int) or value < 1:
            raise ValueError(f"[sweep] {name}: must be a positive whole number, got {value!r}")
    study = _study(about, tables, file.parent)
    return SweepConfig(study, folder, keep, _stop(tables.get("stop", {})), chunk, workers)


def _study(about: dict[str, Any], tables: dict[str, Any], here: Path) -> mc.Study:
    if (name := about.pop("study", None)) is not None:
        _only(about | {k: v for k, v in tables.items() if k != "sweep"}, {"stop"}, "[sweep] with study")
        return _from_python(name, here)
    scenario = _scenario(about, here)
    mode, nodes = about.pop("mode", "default"), about.pop("nodes", None)
    planner = _choose(MODES, mode, "[sweep] mode")(nodes)
    sampling = _sampling(about)
    _only(about, set(), "[sweep]")
    parameters = [_parameter(dict(table), i) for i, table in enumerate(tables.get("parameter", []), start=1)]
    if not parameters:
        raise ValueError("[[parameter]]: nothing varies; give a table [[parameter]] for each leaf that does")
    pairs = {}
    for table in tables.get("correlation", []):
        _only(table, {"between", "value"}, "[[correlation]]")
        pairs[tuple(_needed(table, "between", "[[correlation]]"))] = _needed(
            table, "value", "[[correlation]]"
        )
    return mc.Study(planner, scenario, parameters, sampling, pairs)


def _from_python(name: str, here: Path) -> mc.Study:
    """The study that ``"study.py:make"`` names: an object of a Python file, or the result of its function."""
    file, _, attribute = name.partition(":")
    path = here / file
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if not path.is_file() or spec is None or not isinstance(spec.loader, SourceFileLoader) or not attribute:
        raise ValueError(f'[sweep] study: expected "FILE.py:NAME" of a file beside this one, got {name!r}')
    module = importlib.util.module_from_spec(spec)
    # The text, not cached bytecode: that counts as fresh after an edit within a second that leaves the size.
    exec(spec.loader.source_to_code(path.read_bytes(), str(path)), module.__dict__)
    found = getattr(module, attribute, None)
    found = found() if callable(found) else found
    if not isinstance(found, mc.Study):
        raise ValueError(f"[sweep] study: {attribute} of {file} gives a {type(found).__name__}, not a Study")
    return found


def _scenario(about: dict[str, Any], here: Path) -> LandingScenario:
    case, stored = about.pop("case", None), about.pop("scenario", None)
    if (case is None) == (stored is None):
        raise ValueError(
            f"[sweep]: give one of case ({', '.join(CASES)}), scenario (a file of scenario.save) or study"
        )
    return _choose(CASES, case, "[sweep] case")() if stored is None else LandingScenario.load(here / stored)


def _sampling(about: dict[str, Any]) -> mc.Sampling:
    name = about.pop("sampling", "independent")
    if name == "grid":
        return mc.Grid(tuple(about.pop("points", ())))
    _needed(about, "count", "[sweep]")
    return _choose(SAMPLERS, name, "[sweep] sampling")(about.pop("count"), about.pop("seed", 0))


def _parameter(table: dict[str, Any], number: int) -> mc.Parameter:
    where = f"[[parameter]] {number}"
    given = [name for name in DISTRIBUTIONS if name in table]
    if len(given) != 1:
        raise ValueError(f"{where}: give one of {', '.join(DISTRIBUTIONS)}, got {', '.join(given) or 'none'}")
    numbers = table.pop(given[0])
    try:
        distribution = DISTRIBUTIONS[given[0]](**numbers)
    except (TypeError, AttributeError) as error:
        raise ValueError(f"{where} {given[0]}: {error}") from error
    changes = {"set": mc.Set(), "add": mc.Add(), "scale": mc.Scale()}
    index = table.pop("index", None)
    leaf, change = (
        _needed(table, "leaf", where),
        _choose(changes, table.pop("change", "set"), f"{where} change"),
    )
    _only(table, {"leaf", "name", "unit"}, where)
    index = tuple(index) if isinstance(index, list) else index
    return mc.Parameter(leaf, distribution, table.get("name", ""), table.get("unit", ""), index, change)


def _keep(asked: Any) -> mc.Keep:
    if isinstance(asked, dict):
        return mc.EveryNth(_needed(asked, "every", "[sweep] keep"))
    choices = {"none": mc.NoTrajectories(), "all": mc.AllTrajectories(), "failures": mc.FailedTrajectories()}
    return _choose(choices, asked, "[sweep] keep")


def _stop(table: dict[str, Any]) -> tuple[mc.Stop, ...]:
    _only(table, {"share_width", "mean_of", "mean_width", "seconds", "confidence"}, "[stop]")
    confidence, rules = table.get("confidence", 0.95), []
    if "share_width" in table:
        rules.append(mc.NarrowShare(table["share_width"], confidence=confidence))
    if "mean_width" in table:
        rules.append(mc.NarrowMean(_needed(table, "mean_of", "[stop]"), table["mean_width"], confidence))
    if "seconds" in table:
        rules.append(mc.Budget(table["seconds"]))
    return tuple(rules)


def _choose(choices: dict[str, Any], name: Any, where: str) -> Any:
    if not isinstance(name, str) or name not in choices:
        raise ValueError(f"{where}: choose from {', '.join(choices)}, got {name!r}")
    return choices[name]


def _needed(table: dict[str, Any], key: str, where: str) -> Any:
    if key not in table:
        raise ValueError(f"{where}: {key} is missing")
    return table[key]


def _only(table: dict[str, Any], known: set[str], where: str) -> None:
    if unknown := sorted(set(table) - known):
        raise ValueError(
            f"{where}: unknown key {unknown[0]!r}; known are {', '.join(sorted(known)) or 'no more'}"
        )
