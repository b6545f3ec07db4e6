"""The file of ``jaxscp sweep``: a TOML table with the study, its folder, and rules that end it."""

import importlib.util
import math
import reprlib
import tomllib
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.machinery import SourceFileLoader
from pathlib import Path
from typing import Any, NamedTuple

import jaxscp.monte_carlo as mc
from jaxscp.cli.requests import CASES, MODES
from jaxscp.landing.scenario import LandingScenario


class Kind(NamedTuple):
    """Kind of a value: its name in messages, and its test."""

    text: str
    holds: Callable[[Any], bool]


def _whole(least: int) -> Kind:
    return Kind(f"a whole number, {least} or more", lambda v: type(v) is int and least <= v < 2**63)


def _list_of(kind: Kind) -> Kind:
    return Kind(
        f"a list; each value: {kind.text}",
        lambda v: isinstance(v, list) and v != [] and all(map(kind.holds, v)),
    )


# ``type``, since ``True`` is an int of Python; TOML's whole numbers have 64 bits.
COUNT = _whole(1)
NUMBER = Kind("a number", lambda v: type(v) in (int, float) and abs(v) < 1e300)
LIMIT = Kind("a number or inf", lambda v: NUMBER.holds(v) or (type(v) is float and math.isinf(v)))
POSITIVE = Kind("a positive number", lambda v: NUMBER.holds(v) and v > 0)
LEVEL = Kind("a number from 0.5, below 1", lambda v: NUMBER.holds(v) and 0.5 <= v < 1)
WITHIN_ONE = Kind("a number between -1 and 1", lambda v: NUMBER.holds(v) and -1 < v < 1)
UNIT = Kind("text in quotes", lambda v: isinstance(v, str))
TEXT = Kind("text in quotes, not empty", lambda v: isinstance(v, str) and v != "")
PAIR = Kind("a list of two names", lambda v: _list_of(TEXT).holds(v) and len(v) == 2 and v[0] != v[1])
INDEX = Kind(
    "a whole number, or a list of them",
    lambda v: _list_of(_whole(-(2**63))).holds(v if isinstance(v, list) else [v]),
)
NEEDED = object()


class Table:
    """A table of the file. ``read`` takes a value out of it, and ``end`` refuses the keys that are left."""

    def __init__(self, content: Any, where: str, joint: str = " "):
        if not isinstance(content, dict):
            raise ValueError(f"{where}: expected a table, got {reprlib.repr(content)}")
        self.content, self.where, self.joint = dict(content), where, joint
        self.known: list[str] = []

    def read(self, key: str, kind: Kind, default: Any = NEEDED) -> Any:
        """The value of a key, checked; the default where the table does not have the key."""
        self.known.append(key)
        where = f"{self.where}{self.joint}{key}"
        if key in self.content:
            if not kind.holds(value := self.content.pop(key)):
                raise ValueError(f"{where}: expected {kind.text}, got {reprlib.repr(value)}")
            return value
        if default is NEEDED:
            other = f"; the table has {', '.join(self.content)}" if self.content else ""
            raise ValueError(f"{where}: is missing; expected {kind.text}{other}")
        return default

    def choose(self, key: str, choices: dict[str, Any], default: str, other: str = "") -> Any:
        """The choice that the value of a key names."""
        kind = Kind(f"one of {', '.join(choices)}{other}", lambda v: isinstance(v, str) and v in choices)
        return choices[self.read(key, kind, default)]

    def table(self, key: str) -> "Table":
        """The table of a key."""
        self.known.append(key)
        return Table(self.content.pop(key), f"{self.where}{self.joint}{key}", ".")

    def end(self) -> None:
        """Refuse keys that were not read."""
        for key in self.content:
            raise ValueError(f"{self.where}: unknown key {key!r}; known are {', '.join(self.known)}")


class Form(NamedTuple):
    """Form of a distribution: its class, and the kinds of its fields."""

    make: Callable[..., mc.Distribution]
    needed: dict[str, Kind]
    optional: dict[str, Kind]


FORMS = {
    "uniform": Form(mc.Uniform, {"lower": NUMBER, "upper": NUMBER}, {}),
    "log_uniform": Form(mc.LogUniform, {"lower": NUMBER, "upper": NUMBER}, {}),
    "normal": Form(mc.Normal, {"mean": NUMBER, "deviation": NUMBER}, {"lower": LIMIT, "upper": LIMIT}),
    "choice": Form(
        lambda values, weights=None: mc.Choice(tuple(values), None if weights is None else tuple(weights)),
        {"values": _list_of(NUMBER)},
        {"weights": _list_of(NUMBER)},
    ),
}
DISTRIBUTIONS = (*FORMS, "scipy")
SAMPLERS: dict[str, Callable[..., Any]] = {
    "independent": mc.Independent,
    "latin_hypercube": mc.LatinHypercube,
    "sobol": mc.Sobol,
    "grid": mc.Grid,
}


class SweepConfig(NamedTuple):
    """Content of the file."""

    study: mc.Study
    folder: str
    keep: mc.Keep
    stop: tuple[mc.Stop, ...]
    chunk: int
    workers: int


@contextmanager
def errors_of(where: object, *more: type[Exception]) -> Iterator[None]:
    """A ``ValueError``, and more errors if asked, gets the name of its place before its text, in one line."""
    try:
        yield
    except (ValueError, *more) as error:
        text = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"{where}: {text}") from error


def read_config(file: Path) -> SweepConfig:
    """Read a configuration.

    Raises:
        ValueError: if a key is unknown, missing or wrong; the message names the file and the key.
        OSError: if the file cannot be read.
    """
    content = file.read_bytes()
    with errors_of(file):
        with errors_of("expected TOML, text in UTF-8", RecursionError):
            tables = tomllib.loads(content.decode("utf-8-sig"))
        if unknown := sorted(set(tables) - {"sweep", "parameter", "correlation", "stop"}):
            raise ValueError(
                f"unknown table [{unknown[0]}]; known are [sweep], [[parameter]], [[correlation]], [stop]"
            )
        about = Table(tables.get("sweep", {}), "[sweep]")
        folder = about.read("folder", TEXT, f"{file.stem}_results")
        keep, chunk, workers = _keep(about), about.read("chunk", COUNT, 100), about.read("workers", COUNT, 1)
        stop = _stop(Table(tables.get("stop", {}), "[stop]"))
        return SweepConfig(_study(about, tables, file.parent), folder, keep, stop, chunk, workers)


def _study(about: Table, tables: dict[str, Any], here: Path) -> mc.Study:
    parameters, correlations = _repeated(tables, "parameter"), _repeated(tables, "correlation")
    name = about.read("study", TEXT, None)
    if name is not None:
        about.end()
        if parameters or correlations:
            raise ValueError(
                f"[sweep] study: {name} has its parameters; write no [[parameter]] or [[correlation]]"
            )
        return _from_python(name, here)
    scenario = _scenario(about, here)
    mode, nodes = about.choose("mode", MODES, "default"), about.read("nodes", _whole(2), None)
    sampling = _sampling(about)
    about.end()
    if not parameters:
        raise ValueError("[[parameter]]: nothing varies; give a table [[parameter]] for each leaf that does")
    pairs = {}
    for table in correlations:
        pair = tuple(table.read("between", PAIR))
        pairs[pair] = table.read("value", WITHIN_ONE)
        table.end()
    return mc.Study(mode(nodes), scenario, [_parameter(table) for table in parameters], sampling, pairs)


def _repeated(tables: dict[str, Any], name: str) -> list[Table]:
    found = tables.get(name, [])
    if not isinstance(found, list):
        shown = "one table" if isinstance(found, dict) else reprlib.repr(found)
        raise ValueError(f"[{name}]: expected a list of tables, got {shown}; write [[{name}]]")
    return [Table(content, f"[[{name}]] {number}") for number, content in enumerate(found, start=1)]


def _from_python(name: str, here: Path) -> mc.Study:
    """The study that ``"study.py:make"`` names: an object of a Python file, or the result of its function."""
    file, _, attribute = name.partition(":")
    path = here / file
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if not path.is_file() or spec is None or not isinstance(spec.loader, SourceFileLoader) or not attribute:
        raise ValueError(f'[sweep] study: expected "FILE.py:NAME" of a file beside this one, got {name!r}')
    module = importlib.util.module_from_spec(spec)
    try:
        # The text, not cached bytecode: that counts as fresh after an edit within a second that leaves the size.
        exec(spec.loader.source_to_code(path.read_bytes(), str(path)), module.__dict__)
        if not hasattr(module, attribute):
            raise ValueError(f"there is no {attribute}")
        found = getattr(module, attribute)
        found = found() if callable(found) else found
    except (Exception, SystemExit) as error:
        lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == str(path)]
        place = f"{file}, line {lines[-1]}" if lines else file
        text = " ".join(f"{type(error).__name__}: {error}".split())
        raise ValueError(f"[sweep] study: {place}: {text}") from error
    if not isinstance(found, mc.Study):
        raise ValueError(f"[sweep] study: {attribute} of {file} gives a {type(found).__name__}, not a Study")
    return found


def _scenario(about: Table, here: Path) -> LandingScenario:
    if ("case" in about.content) == ("scenario" in about.content):
        raise ValueError(
            f"[sweep]: give one of case ({', '.join(CASES)}), scenario (a file of scenario.save) or study"
        )
    if "case" in about.content:
        return about.choose("case", CASES, "")()
    stored = about.read("scenario", TEXT)
    with errors_of("[sweep] scenario", OSError):
        return LandingScenario.load(here / stored)


def _sampling(about: Table) -> mc.Sampling:
    sampler = about.choose("sampling", SAMPLERS, "independent")
    if sampler is mc.Grid:
        return mc.Grid(tuple(about.read("points", _list_of(COUNT))))
    return sampler(about.read("count", COUNT), about.read("seed", _whole(0), 0))


def _parameter(table: Table) -> mc.Parameter:
    given = [name for name in DISTRIBUTIONS if name in table.content]
    if len(given) != 1:
        raise ValueError(
            f"{table.where}: give one of {', '.join(DISTRIBUTIONS)}, got {' and '.join(given) or 'none'}"
        )
    distribution = _distribution(table.table(given[0]))
    leaf, index = table.read("leaf", TEXT), table.read("index", INDEX, None)
    name, unit = table.read("name", TEXT, ""), table.read("unit", UNIT, "")
    change = table.choose("change", {"set": mc.Set(), "add": mc.Add(), "scale": mc.Scale()}, "set")
    table.end()
    index = tuple(index) if isinstance(index, list) else index
    return mc.Parameter(leaf, distribution, name, unit, index, change)


def _distribution(table: Table) -> mc.Distribution:
    form = FORMS.get(table.where.rpartition(" ")[2]) or _of_scipy(table)
    fields = {key: table.read(key, kind) for key, kind in form.needed.items()}
    given = {key: table.read(key, kind, None) for key, kind in form.optional.items()}
    table.end()
    with errors_of(table.where, ArithmeticError):
        return form.make(**fields, **{key: value for key, value in given.items() if value is not None})


def _of_scipy(table: Table) -> Form:
    import scipy.stats as stats

    classes = stats.rv_continuous, stats.rv_discrete
    # most names of the module are functions, which must not be called: one runs SciPy's tests
    kind = Kind(
        "a distribution of scipy.stats, gamma or triang say",
        lambda v: isinstance(v, str) and isinstance(getattr(stats, v, None), classes),
    )
    family = getattr(stats, table.read("name", kind))
    shapes = [name.strip() for name in (family.shapes or "").split(",") if name.strip()]
    scale = {"scale": POSITIVE} if isinstance(family, stats.rv_continuous) else {}
    return Form(
        lambda **fields: mc.SciPy(family(**fields)), dict.fromkeys(shapes, NUMBER), {"loc": NUMBER, **scale}
    )


def _keep(about: Table) -> mc.Keep:
    if isinstance(about.content.get("keep"), dict):
        table = about.table("keep")
        every = table.read("every", COUNT)
        table.end()
        return mc.EveryNth(every)
    choices = {"none": mc.NoTrajectories(), "all": mc.AllTrajectories(), "failures": mc.FailedTrajectories()}
    return about.choose("keep", choices, "none", ", { every = NUMBER }")


def _stop(table: Table) -> tuple[mc.Stop, ...]:
    of_mean = NEEDED if {"mean_of", "mean_width"} & set(table.content) else None
    share, seconds = table.read("share_width", POSITIVE, None), table.read("seconds", POSITIVE, None)
    mean, width = table.read("mean_of", TEXT, of_mean), table.read("mean_width", POSITIVE, of_mean)
    confidence = table.read("confidence", LEVEL, 0.95)
    table.end()
    rules: list[mc.Stop] = [] if share is None else [mc.NarrowShare(share, confidence=confidence)]
    rules += [] if mean is None else [mc.NarrowMean(mean, width, confidence)]
    return tuple(rules + ([] if seconds is None else [mc.Budget(seconds)]))
