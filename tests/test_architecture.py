"""The house: rooms in layers, no circles, short files and functions, and the field's own words."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1] / "jaxscp"
LAYERS = (
    ("core", "backends"),
    ("cones", "aot", "linalg", "integration", "corridor"),
    ("dynamics", "conic"),
    ("problem",),
    ("transcription", "verification"),
    ("nlp",),
    ("scp",),
    ("solver", "landing", "control", "simulation"),
    ("plot", "mission", "monte_carlo"),
    ("cli",),
    ("__main__",),
)
LAYER = {room: number for number, rooms in enumerate(LAYERS, start=1) for room in rooms}
MOST_ROOMS, MOST_ARROWS, MOST_FLOORS = 24, 85, 11  # fewer than four arrows a room; no more floors than layers
MOST_LINES, MOST_FUNCTION_LINES, MOST_ARGUMENTS = 300, 50, 7
CONES = {"Cone", "Zero", "NonNegative", "SecondOrder", "SymmetricCone"}

# The verifier shares the class of tableaus with the solver, and its gradient the statement of an interval and the
# integration in JAX. They share none of the solver's compiled integration, and use another tableau.
SHARED_WITH_VERIFIER = {"tableaus"}
SHARED_WITH_GRADIENT = {"intervals", "in_jax", "tableaus"}

# Words of this package's own past that have no standard meaning: they may stand in no identifier.
PRIVATE = re.compile(
    r"(^|_)(lacks?|owed|apart|lanes?|kept|ahead|flown|reflown|lifted|loaded|foretold|foreseen|weigh|weighed|pulled|"
    r"sweeps?|passes|stretch|stretches|judge|judged|wanted|settled|prices?|poles|anew|begun_anew|quickly|played|"
    r"tiles?|published|fly|kink|followed|unit_of|owes)($|_)",
    re.IGNORECASE,
)
# The word that belongs to Monte Carlo.
OWN_WORD = re.compile(r"sweeps?", re.IGNORECASE)
# Words that have a standard meaning too: they may not stand in the old one.
PRIVATE_IN_FILE = {
    "scp/newton.py": {"polish", "finish", "reached", "near", "slack", "past", "exact"},
    "scp/state.py": {"near", "reached", "past", "exact", "newton_steps"},
    "scp/ptr.py": {"SHARE", "KEPT", "ENDING", "moved", "virtual"},
    "scp/convex_model.py": {"near", "held", "pull", "own"},
    "scp/active_set.py": {"pull", "room", "on"},
    "scp/second_order_correction.py": {"hold", "held", "rest", "HOLD"},
    "scp/line_search.py": {"room", "enough", "rest"},
    "scp/history.py": {"virtual", "step"},
    "nlp/interior_point.py": {"shift", "moved", "FOLLOWED", "LONGEST", "first", "ended", "owed"},
    "nlp/central_path.py": {"ROOM", "inverse"},
    "transcription/shooting.py": {"bend", "keep", "given"},
    "transcription/inequalities.py": {"room", "unit"},
    "verification/certificate.py": {"safe", "acceptable"},
    "solver/solution.py": {"newton_steps", "allocation"},
    "conic/warm_start.py": {"ROOM", "near", "known"},
}


def files():
    """All Python files of the package."""
    return sorted(file for file in ROOT.rglob("*.py") if "__pycache__" not in file.parts)


def room_of(file: Path) -> str:
    """The room of a file."""
    return file.relative_to(ROOT).parts[0].removesuffix(".py")


@cache
def tree_of(file: Path) -> ast.Module:
    """The syntax tree of a file."""
    return ast.parse(file.read_text())


def module_name(file: Path) -> str:
    """The dotted name of a file's module."""
    parts = file.relative_to(ROOT.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def modules() -> dict[str, Path]:
    """Files by the names of their modules."""
    return {module_name(file): file for file in files()}


def target(name: str) -> Path | None:
    """The file that an imported name comes from."""
    while name and name not in modules():
        name = name.rpartition(".")[0]
    return modules().get(name)


def imported_names(file: Path):
    """Dotted names of the package that a file imports, in functions and type checks too."""
    for node in ast.walk(tree_of(file)):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: relative import"
            if (node.module or "").partition(".")[0] == "jaxscp":
                yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name.partition(".")[0] == "jaxscp")


@cache
def file_arrows() -> dict[Path, set[Path]]:
    """Files that each file imports from."""
    return {
        file: {t for name in imported_names(file) if (t := target(name)) not in (None, file)}
        for file in files()
    }


@cache
def room_arrows() -> dict[str, set[str]]:
    """Rooms that each room imports from."""
    arrows: dict[str, set[str]] = {}
    for file, targets in file_arrows().items():
        if file.parent != ROOT or file.stem == "__main__":
            others = {room_of(t) for t in targets} - {room_of(file)}
            arrows.setdefault(room_of(file), set()).update(others)
    return arrows


def functions(file: Path):
    """Functions of a file, inner ones too."""
    return (n for n in ast.walk(tree_of(file)) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef))


def circle(arrows) -> list | None:
    """A circle of a graph, or None."""
    done, path = set(), []

    def visit(node):
        if node in path:
            return [*path[path.index(node) :], node]
        if node in done:
            return None
        path.append(node)
        for after in sorted(arrows.get(node, ())):
            if (found := visit(after)) is not None:
                return found
        path.pop()
        done.add(node)
        return None

    return next((found for node in sorted(arrows) if (found := visit(node))), None)


def test_the_rooms_are_the_known_ones():
    assert set(room_arrows()) <= set(LAYER)
    assert len(room_arrows()) <= MOST_ROOMS


def test_a_room_imports_rooms_of_lower_layers_only():
    wrong = [(a, b) for a, others in room_arrows().items() for b in others if LAYER[b] >= LAYER[a]]
    assert not wrong


def test_there_are_few_arrows_and_floors():
    @cache
    def floor(room):
        return 1 + max((floor(other) for other in room_arrows()[room]), default=0)

    assert sum(map(len, room_arrows().values())) <= MOST_ARROWS
    assert max(map(floor, room_arrows())) <= MOST_FLOORS


def test_there_is_no_circle_of_files():
    assert circle(file_arrows()) is None


def test_a_circle_would_be_found():
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == ["b", "c", "b"]


@pytest.mark.parametrize("file", files(), ids=lambda file: str(file.relative_to(ROOT)))
def test_files_are_short(file):
    assert len(file.read_text().splitlines()) <= MOST_LINES


def test_functions_are_short():
    lines = {
        (str(f.relative_to(ROOT)), n.name): n.end_lineno - n.lineno + 1 for f in files() for n in functions(f)
    }
    assert not {name: count for name, count in lines.items() if count > MOST_FUNCTION_LINES}


def test_functions_have_few_arguments():
    def count(node):
        of = node.args
        names = [a.arg for a in (*of.posonlyargs, *of.args, *of.kwonlyargs)]
        return len([name for name in names if name not in ("self", "cls")])

    counts = {(str(f.relative_to(ROOT)), n.name): count(n) for f in files() for n in functions(f)}
    assert not {name: number for name, number in counts.items() if number > MOST_ARGUMENTS}


def test_the_kind_of_a_cone_is_asked_in_one_room_only():
    def asks(node):
        if not (
            isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "isinstance"
        ):
            return False
        return any(isinstance(n, ast.Name) and n.id in CONES for n in ast.walk(node.args[1]))

    outside = [f for f in files() if room_of(f) != "cones"]
    assert not [str(f.relative_to(ROOT)) for f in outside for n in ast.walk(tree_of(f)) if asks(n)]


def test_nothing_inside_imports_the_package_itself_or_private_parts_of_jax():
    for file in files():
        for node in ast.walk(tree_of(file)):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            assert "jaxscp" not in names, file
            assert not any(name.startswith("jax._src") for name in names), file


def test_the_first_file_of_every_room_is_lazy():
    """A room's ``__init__`` has a docstring, or a list of names that are imported on first use."""
    for file in ROOT.glob("*/__init__.py"):
        statements = tree_of(file).body
        allowed = ("Expr", "Import", "Assign")
        assert all(type(s).__name__ in allowed for s in statements), file
        imports = [alias.name for s in statements if isinstance(s, ast.Import) for alias in s.names]
        assert imports in ([], ["lazy_loader"]), file


def test_the_verifier_shares_no_integration_with_the_solver():
    prefix = "jaxscp.integration."

    def found(files):
        names = (name for file in files for name in imported_names(file) if name.startswith(prefix))
        return {name.removeprefix(prefix).partition(".")[0] for name in names}

    assert found(file for file in files() if room_of(file) == "verification") <= SHARED_WITH_VERIFIER
    assert found([ROOT / "transcription" / "gradient.py"]) <= SHARED_WITH_GRADIENT


def identifiers(file: Path):
    """Names that a file gives: functions, classes, arguments and variables."""
    for node in ast.walk(tree_of(file)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id


@pytest.mark.parametrize("file", files(), ids=lambda file: str(file.relative_to(ROOT)))
def test_identifiers_are_the_fields_own(file):
    names = set(identifiers(file))
    own = OWN_WORD if room_of(file) in ("monte_carlo", "cli") else None
    assert not {name for name in names if PRIVATE.search(name if own is None else own.sub("", name))}
    assert not names & PRIVATE_IN_FILE.get(file.relative_to(ROOT).as_posix(), set())


def test_the_files_of_old_words_exist():
    assert all((ROOT / name).exists() for name in PRIVATE_IN_FILE)


def test_tests_mirror_the_rooms():
    folders = {
        p.name for p in Path(__file__).parent.iterdir() if p.is_dir() and not p.name.startswith((".", "_"))
    }
    assert folders <= set(LAYER) | {"support", "system"}
