"""Names shared by the build hook, the table of libraries, and the C++."""

import re
from pathlib import Path

import pytest

from jaxscp.backends import cuda, libraries
from jaxscp.backends.codegen import tape

ROOT = Path(__file__).parents[2]
PACKAGE = Path(libraries.__file__).parents[1]


def sources(library):
    return "".join(file.read_text() for file in library.stem.parent.glob("*.cc"))


def test_the_build_hook_compiles_every_library_and_no_other():
    hatch_build = (ROOT / "hatch_build.py").read_text()
    built = {ROOT / stem for stem in re.findall(r'Path\("(jaxscp/\S+/native/\w+)"\): \(', hatch_build)}
    assert {stem.relative_to(ROOT) for stem in built} == {
        library.stem.relative_to(PACKAGE.parent) for library in libraries.EVERY
    }


@pytest.mark.parametrize("library", libraries.EVERY, ids=lambda library: library.stem.name)
def test_ffi_targets_are_the_symbols_of_the_c_plus_plus(library):
    symbols = re.findall(r"XLA_FFI_DEFINE_HANDLER_SYMBOL\(\s*(\w+)", sources(library))
    assert sorted(symbols) == sorted(filter(None, (*library.targets, library.on_gpu)))


def test_no_compiled_file_belongs_to_a_library_of_another_name():
    """A file of an old name would be packed and never loaded."""
    stems = {library.stem for library in libraries.EVERY}
    for file in PACKAGE.rglob("native/*.so"):
        assert file.with_name(file.stem.rpartition("_")[0]) in stems


def test_operations_have_the_same_codes_in_python_and_in_the_c_plus_plus():
    text = (PACKAGE / "integration/native/tape.h").read_text()
    names = re.search(r"enum Code \{(.*?)\}", text, re.DOTALL)
    assert names is not None
    in_cpp = [name.strip().removeprefix("k") for name in names[1].split(",") if name.strip()]
    short = {"lt": "less", "le": "lessequal", "gt": "greater", "ge": "greaterequal", "eq": "equal"}
    in_python = [short.get(name, name.replace("_", "")) for name in tape.CODES]
    assert [name.lower() for name in in_cpp] == in_python


@pytest.mark.parametrize(
    "library",
    [library for library in libraries.EVERY if library.on_gpu],
    ids=lambda library: library.stem.name,
)
def test_launchers_read_the_attributes_that_carry_a_kernel(library):
    text = (library.stem.parent / "gpu_handler.cc").read_text()
    assert all(f'("{name}")' in text for name in cuda.attributes(b"a cubin"))
