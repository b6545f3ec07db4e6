"""The key of the planner cache: a change of any file of the package makes another key."""

import inspect
import logging
import shutil

import pytest

from jaxscp.aot import export, planner_cache
from jaxscp.aot.archive import COMPILED
from tests.test_architecture import ROOT, files, room_of

ROOMS = sorted({room_of(file) for file in files()})


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """The package's Python files, copied."""
    target = tmp_path_factory.mktemp("package") / "jaxscp"
    shutil.copytree(ROOT, target, ignore=shutil.ignore_patterns("__pycache__", "*.so", "*.h", "*.cc", "*.cu"))
    return target


def digest(root):
    return planner_cache.code_digest.__wrapped__(root)


@pytest.mark.parametrize("room", ROOMS)
def test_a_change_in_any_room_changes_the_key(copy, room):
    before = digest(copy)
    file = next(
        f for f in sorted(copy.rglob("*.py")) if f.relative_to(copy).parts[0].removesuffix(".py") == room
    )
    text = file.read_text()
    file.write_text(text + "\n")
    assert digest(copy) != before
    file.write_text(text)
    assert digest(copy) == before


@pytest.mark.parametrize("name", ["interior_point_any.so", "layout.h", "kernel.cu", "sizes.cuh"])
def test_a_new_library_or_a_kernels_text_changes_the_key(copy, name):
    before = digest(copy)
    file = copy / "conic/native" / name
    file.parent.mkdir(exist_ok=True)
    file.write_bytes(b"code")
    assert digest(copy) != before
    file.unlink()


def test_the_key_is_of_the_whole_package():
    assert inspect.signature(planner_cache.code_digest).parameters["root"].default == ROOT


def test_a_compilation_is_logged(caplog):
    with caplog.at_level(logging.INFO, logger="jaxscp"), planner_cache._logged():
        assert caplog.messages == ["compiling for this planner and these shapes, once"]
    assert caplog.messages[1].startswith("compiled in 0.0 s")


@pytest.mark.parametrize("target", COMPILED)
def test_a_program_names_the_libraries_that_it_calls(target):
    """A CPU target's name may be part of a GPU target's: then both are named, and none is missed."""
    found = export.called_targets(b"\0call " + target.encode() + b"\0")
    assert target in found
    assert all(name in target for name in found)
    assert export.called_targets(b"no call") == []
