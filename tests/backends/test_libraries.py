"""Names shared by the build hook, the table of libraries, and the C++."""

import ctypes
import re
import shutil
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.backends import cuda, libraries
from jaxscp.backends.codegen import tape
from jaxscp.backends.sources import SHARED, digest

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
    symbols = re.findall(r"JAXSCP_HANDLER\((\w+)", sources(library))
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
    text = (library.stem.parent / "gpu_handler.cc").read_text() + (SHARED / "launch.h").read_text()
    assert all(f'("{name}")' in text for name in cuda.attributes(b"a cubin"))


@pytest.fixture
def copied(tmp_path):
    """A function that loads a copy of a library, and the folder of the copy."""
    level = libraries.GRAM.level()
    if level is None:
        pytest.skip("the libraries are not compiled")
    folder = tmp_path / "native"
    shutil.copytree(libraries.GRAM.stem.parent, folder)
    return lambda: libraries.library.__wrapped__(folder / libraries.GRAM.stem.name, level), folder


def test_libraries_for_other_processors_alone_are_named(copied, monkeypatch):
    _, folder = copied
    stem = folder / libraries.GRAM.stem.name
    reasons = {"v4": libraries.OTHER_PROCESSORS}
    monkeypatch.setattr(
        libraries, "_opened", lambda _, name: (None, reasons.get(name, libraries.NOT_COMPILED))
    )
    with pytest.warns(UserWarning, match="instructions that this processor lacks.* again on this machine"):
        assert libraries.level.__wrapped__(stem, libraries.GRAM.targets[0]) is None


def test_a_library_of_the_present_sources_is_loaded(copied):
    load, folder = copied
    assert libraries.compiled_from(load()) == digest(folder)


def test_a_library_older_than_its_sources_is_refused(copied):
    load, folder = copied
    source = folder / "gram.h"
    source.write_text(source.read_text() + "\n// changed\n")
    with pytest.warns(UserWarning, match="older than its sources .* install jaxscp again"):
        assert load() is None


def test_a_change_of_a_shared_header_changes_the_digest(tmp_path):
    own, shared = libraries.GRAM.stem.parent, tmp_path / "shared"
    shutil.copytree(libraries.HEADERS, shared)
    assert digest(own, shared) == digest(own)
    (shared / "pack.h").write_text("")
    assert digest(own, shared) != digest(own)


def test_a_library_from_before_there_was_a_digest_has_none():
    assert libraries.compiled_from(ctypes.CDLL(None)) == ""


def test_a_call_of_the_c_plus_plus_says_what_it_lacks():
    assert libraries.GRAM.available()
    assert libraries.EIGEN.available()
    matrix = jax.ShapeDtypeStruct((2, 2), jnp.float64)
    eigen = jax.ffi.ffi_call(libraries.EIGEN.targets[1], (jax.ShapeDtypeStruct((2,), jnp.float64), matrix))
    np.testing.assert_allclose(eigen(jnp.diag(jnp.array([1.0, 2.0])))[0], [1.0, 2.0])
    with pytest.raises(jax.errors.JaxRuntimeError, match="another type of numbers"):
        jax.block_until_ready(eigen(jnp.eye(2, dtype=jnp.float32)))
    with pytest.raises(jax.errors.JaxRuntimeError, match="lacks an axis"):
        jax.block_until_ready(eigen(jnp.array(1.0)))
    with pytest.raises(jax.errors.JaxRuntimeError, match="lacks an argument"):
        jax.block_until_ready(eigen())
    with pytest.raises(jax.errors.JaxRuntimeError, match="or has too many"):
        jax.block_until_ready(eigen(jnp.eye(2), jnp.eye(2)))
    with pytest.raises(jax.errors.JaxRuntimeError, match="lacks the attribute rank_one"):
        jax.block_until_ready(jax.ffi.ffi_call(libraries.GRAM.targets[0], (matrix, matrix))())
