"""The build of the C++ libraries: paths, headers and object files."""

import importlib.util
import re
import shutil
from pathlib import Path

import pytest

from jaxscp.backends import libraries

ROOT = Path(__file__).parents[2]
SOURCES = sorted(
    file
    for file in (ROOT / "jaxscp").rglob("*")
    if file.suffix in (".h", ".cc", ".cu") and "native" in file.parts
)


@pytest.fixture(scope="module")
def hook():
    """The build hook, as a module."""
    pytest.importorskip("hatchling", reason="the build hook needs hatchling")
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_build_and_the_package_agree_on_the_libraries(hook):
    built = {ROOT / stem for stem in hook.LIBRARIES}
    assert built == {library.stem for library in libraries.EVERY}
    assert (ROOT / hook.SHARED).resolve() == libraries.HEADERS.resolve()


def test_every_source_of_a_library_exists(hook):
    for stem, parts in hook.LIBRARIES.items():
        for name in (*parts[0], *parts[1]):
            assert (ROOT / stem).parent.joinpath(f"{name}.cc").exists()


def test_object_files_of_a_library_have_names_of_their_own(hook):
    """Several rooms have a ``handler.cc``: each library is compiled in a folder of its own."""
    for stem, parts in hook.LIBRARIES.items():
        names = [*parts[0], *parts[1], "runs_here"]
        assert len(set(names)) == len(names), stem


@pytest.fixture
def on_x86(hook, monkeypatch):
    """A function that gives the instruction sets on an x86 machine that runs the given ones."""
    monkeypatch.setattr(hook.platform, "machine", lambda: "x86_64")
    monkeypatch.delenv(hook.ALL, raising=False)

    def levels(*running, version="standard"):
        monkeypatch.setattr(hook, "runs_here", lambda compiler, root, level: level in running)
        return set(hook.levels_for(version, "c++", ROOT))

    return levels


def test_an_installation_compiles_for_its_own_machine(on_x86):
    assert on_x86("v3", "v4") == {"v3", "v4"}
    assert on_x86("v3") == {"v3"}
    assert on_x86() == {"any"}


def test_tests_and_wheels_for_other_machines_have_all_instruction_sets(hook, on_x86, monkeypatch):
    assert on_x86("v3", version="editable") == {"any", "v3", "v4"}
    monkeypatch.setenv(hook.ALL, "1")
    assert on_x86("v3") == {"any", "v3", "v4"}


def test_the_build_asks_the_processor_as_the_libraries_do(hook):
    if (compiler := shutil.which("c++")) is None or not libraries.GRAM.level():
        pytest.skip("needs a C++ compiler and the libraries")
    for level in hook.X86:
        assert hook.runs_here(compiler, ROOT, level) == (
            libraries.library(libraries.GRAM.stem, level) is not None
        )


@pytest.mark.parametrize("file", SOURCES, ids=lambda file: str(file.relative_to(ROOT)))
def test_own_headers_are_found_and_never_shadow_the_systems(file):
    """Headers of our own are included in quotes; ``memory.h`` and ``threads.h`` are names of the system too."""
    own = {f.name for f in SOURCES if f.suffix == ".h"}
    for line in file.read_text().splitlines():
        if match := re.match(r'\s*#include "([^"]+)"', line):
            name = match[1]
            if name in own:
                assert (file.parent / name).exists() or (libraries.HEADERS / name).exists(), line
        if match := re.match(r"\s*#include <([^>]+)>", line):
            assert match[1] not in own, line
