"""What Python tells of functions, classes and modules: names that they read, versions, and which are libraries."""

import copyreg
import dis
import functools
import importlib
import importlib.metadata
import importlib.util
import inspect
import json
import sys
import sysconfig
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

PACKAGE = __name__.partition(".")[0]
_LOOKUPS = "LOAD_GLOBAL", "LOAD_NAME", "LOAD_FROM_DICT_OR_GLOBALS"


def codes(code: types.CodeType) -> Iterator[types.CodeType]:
    """The code of a function, and of all functions inside it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from codes(constant)


def global_names(code: types.CodeType) -> set[str]:
    """Global names that a function reads, less those that it assigns: they are its state, not its definition.

    Example:
        >>> global_names((lambda b: len(b.mass)).__code__)
        {'len'}
    """
    steps = [step for part in codes(code) for step in dis.get_instructions(part)]
    read = {step.argval for step in steps if step.opname in _LOOKUPS}
    return read - {step.argval for step in steps if step.opname == "STORE_GLOBAL"}


def all_names(code: types.CodeType) -> frozenset[str]:
    """Every global name and attribute that a function names."""
    return frozenset(name for part in codes(code) for name in part.co_names)


def assigned_attributes(code: types.CodeType, owner: str) -> set[str]:
    """Attributes of the global ``owner`` that a function assigns: ``owner.calls = 0`` or ``owner.calls += 1``."""
    found = set()
    for part in codes(code):
        steps = list(dis.get_instructions(part))
        stored = {step.argval for step in steps if step.opname == "STORE_ATTR"}
        for here, after, second in zip(steps, steps[1:], steps[2:], strict=False):
            if here.opname == "LOAD_GLOBAL" and here.argval == owner:
                if after.opname == "STORE_ATTR":
                    found.add(after.argval)
                elif after.opname == "COPY" and second.argval in stored:  # of an augmented assignment
                    found.add(second.argval)
    return found


def imports(code: types.CodeType, package: str) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Modules that a function imports when it runs, and the names that it takes from each.

    Args:
        code: of the function.
        package: of its module, for relative imports.
    """
    for part in codes(code):
        steps = list(dis.get_instructions(part))
        for level, names, step in zip(steps, steps[1:], steps[2:], strict=False):
            if step.opname == "IMPORT_NAME":
                dots = "." * (level.argval or 0)
                name = importlib.util.resolve_name(dots + step.argval, package) if dots else step.argval
                yield name, names.argval or ()


@functools.cache
def is_library(module: str) -> bool:
    """Whether a module is of Python, of jaxscp, or of an installed package.

    Example:
        >>> is_library("numpy.linalg"), is_library("__main__")
        (True, False)
    """
    top = module.partition(".")[0]
    if top in (PACKAGE, "__main__"):
        return top == PACKAGE
    folders = [Path(sysconfig.get_paths()[name]) for name in ("stdlib", "platstdlib", "purelib", "platlib")]
    places = _places(top)
    if not places:
        return top in sys.stdlib_module_names
    return any(
        place.is_relative_to(folder) or {"site-packages", "dist-packages"} & set(place.parts)
        for place in places
        for folder in folders
    )


def _places(top: str) -> list[Path]:
    """Files and folders of a package."""
    about: Any = sys.modules.get(top)
    if about is None and top:
        about = importlib.util.find_spec(top)
    names = [getattr(about, name, None) for name in ("__file__", "origin")]
    folders = getattr(about, "__path__", None) or getattr(about, "submodule_search_locations", None) or ()
    return [Path(name) for name in (*names, *folders) if isinstance(name, str) and Path(name).is_absolute()]


@functools.cache
def version(module: str) -> str | None:
    """Version of a library; None of Python's own modules, and where there is none.

    Example:
        >>> version("numpy.linalg") == version("numpy"), version("math")
        (True, None)
    """
    top = module.partition(".")[0]
    if top in sys.stdlib_module_names or top == PACKAGE:  # a study compares the code of jaxscp by itself
        return None
    try:
        return importlib.metadata.version(top)
    except importlib.metadata.PackageNotFoundError:
        pass
    try:
        found = getattr(importlib.import_module(top), "__version__", None)
    except ImportError:
        return None
    return found if isinstance(found, str) else None


def with_version(name: str, module: str) -> str:
    """A name in a module, with the version of the module's package."""
    return f"{name} {found}" if (found := version(module)) else name


def named_in_library(value: Any, name: str) -> str | None:
    """Dotted name of an object of a library, if this name determines it.

    Example:
        >>> import json
        >>> named_in_library(json.dumps, "dumps"), named_in_library(lambda x: x, "<lambda>")
        ('json.dumps', None)
    """
    kind = type(value).__module__.partition(".")[0]
    for module in (getattr(value, "__module__", None), kind, "scipy.special"):
        found: Any = sys.modules.get(module or "")
        for part in name.split("."):
            found = getattr(found, part, None)
        if found is value and module and is_library(module):
            return with_version(f"{module}.{name}", module)
    return None


def reduced(value: Any) -> Any:
    """What pickle would store of an object.

    Raises:
        Exception: any, if it cannot be stored.
    """
    by_type = copyreg.dispatch_table.get(type(value))
    return value.__reduce_ex__(4) if by_type is None else by_type(value)


def function_in(value: Any) -> types.FunctionType | None:
    """The function of a method, a static method or a property; None of anything else."""
    if isinstance(value, staticmethod | classmethod):
        value = value.__func__
    elif isinstance(value, property):
        value = value.fget
    return value if isinstance(value, types.FunctionType) else None


def closure(function: types.FunctionType) -> dict[str, Any]:
    """Values that a function closes over, by name."""

    def content(cell: types.CellType) -> Any:
        try:
            return cell.cell_contents
        except ValueError:  # a name that is not assigned yet
            return "empty"

    cells = map(content, function.__closure__ or ())
    return dict(zip(function.__code__.co_freevars, cells, strict=True))


def globals_read(function: types.FunctionType) -> dict[str, Any]:
    """Values of the global names that a function reads."""
    known = function.__globals__
    return {name: known[name] for name in global_names(function.__code__) if name in known}


def modules_imported(function: types.FunctionType) -> dict[str, Any]:
    """Modules that a function imports when it runs; of a library its version alone, without an import."""
    found: dict[str, Any] = {}
    for module, names in imports(function.__code__, function.__globals__.get("__package__") or ""):
        if is_library(module):
            found[module] = version(module)
            continue
        try:
            found[module] = importlib.import_module(module)
            for name in names:
                if not hasattr(found[module], name):
                    importlib.import_module(f"{module}.{name}")
        except ImportError:
            found.setdefault(module, None)
    return found


def text_of(code: types.CodeType, constant: Callable[[Any], Any]) -> str:
    """Instructions, names and constants of a function, without places in files.

    Args:
        code: of the function.
        constant: from a constant to plain data.
    """
    arguments = code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags
    named = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
    parts = [code.co_code.hex(), code.co_exceptiontable.hex(), repr(arguments), repr(named)]
    parts += [repr(code.co_names), repr(code.co_freevars)]
    for value in code.co_consts:
        inner = isinstance(value, types.CodeType)
        parts.append(text_of(value, constant) if inner else json.dumps(constant(value), sort_keys=True))
    return "\n".join(parts)


def state_of(cls: type, state: dict[Any, Any]) -> dict[str, Any]:
    """Attributes of an object, without its documentation and its cached properties."""
    return {
        str(name): value
        for name, value in state.items()
        if name != "__doc__"
        and not isinstance(inspect.getattr_static(cls, str(name), None), functools.cached_property)
    }
