"""Pytrees in files: they are read back bitwise, and damage is named."""

import json
import zipfile

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp.core import pytree_file


class Pair(eqx.Module):
    first: jax.Array
    second: object
    third: float | None = None


CONTENT = Pair(jnp.array([1.0, jnp.nan, -0.0]), {"a": (jnp.arange(3), "text"), "b": None}, 0.1)


def write(file):
    pytree_file.write(file, {"pair": CONTENT})
    return file


def read(file):
    return pytree_file.read(file, "pair", [Pair])


def changed(file, change):
    """The file with another header."""
    with np.load(file) as archive:
        arrays = dict(archive)
    header = json.loads(str(arrays["header"]))
    change(header, arrays)
    arrays["header"] = np.array(json.dumps(header))
    np.savez(file, **arrays)
    return file


def test_what_is_written_is_read_bitwise(tmp_path):
    found = read(write(tmp_path / "pair.npz"))
    assert jax.tree.structure(found) == jax.tree.structure(CONTENT)
    assert found.second["a"][0].dtype == CONTENT.second["a"][0].dtype
    assert found.first.tobytes() == np.asarray(CONTENT.first).tobytes()
    assert found.third == 0.1
    assert (tmp_path / "pair.npz").exists()


def test_another_part_is_none(tmp_path):
    assert pytree_file.read(write(tmp_path / "pair.npz"), "other", [Pair]) is None


@pytest.mark.parametrize("content", [b"", b"not an archive", b"PK\x03\x04 broken"])
def test_a_file_of_another_kind_is_named(tmp_path, content):
    file = tmp_path / "noise.npz"
    file.write_bytes(content)
    with pytest.raises(ValueError, match=r"noise\.npz: not a file that save wrote"):
        read(file)


def test_every_truncation_is_an_error_that_names_the_file(tmp_path):
    file = write(tmp_path / "pair.npz")
    whole = file.read_bytes()
    for length in range(0, len(whole), 7):
        file.write_bytes(whole[:length])
        with pytest.raises(ValueError, match=r"pair\.npz: not a file"):
            read(file)


def test_a_damaged_byte_is_an_error_that_names_the_field(tmp_path):
    file = write(tmp_path / "pair.npz")
    whole = bytearray(file.read_bytes())
    at = whole.index(np.asarray(CONTENT.first).tobytes())
    whole[at] ^= 1
    file.write_bytes(bytes(whole))
    with pytest.raises(ValueError, match=r"pair\.npz: field 'pair\.first' is damaged"):
        read(file)


def remove_array(header, arrays):
    del arrays["pair.first"]


def remove_field(header, arrays):
    del header["parts"]["pair"]["fields"]["first"]


def rename_class(header, arrays):
    header["parts"]["pair"]["class"] = "Popen"


def add_field(header, arrays):
    header["parts"]["pair"]["fields"]["fourth"] = {"value": 1}


def damage_description(header, arrays):
    header["parts"]["pair"]["fields"]["first"] = 3


def newer(header, arrays):
    header["format"] = pytree_file.FORMAT + 1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (remove_array, r"field 'pair\.first' is missing"),
        (remove_field, r"field 'pair\.first' is missing"),
        (rename_class, r"field 'pair': the class 'Popen' is not expected"),
        (add_field, r"field 'pair\.fourth' is unknown to this version"),
        (damage_description, r"field 'pair\.first': its description in the header is damaged"),
        (newer, r"its format is 2, and this version of jaxscp reads 1; update jaxscp"),
        (lambda header, arrays: header.clear(), "not a file that save wrote: its header has no 'parts'"),
    ],
)
def test_damage_is_named(tmp_path, change, words):
    file = changed(write(tmp_path / "pair.npz"), change)
    with pytest.raises(ValueError, match=rf"pair\.npz: {words}"):
        read(file)


def test_a_field_that_is_younger_than_the_file_has_its_default(tmp_path):
    file = changed(write(tmp_path / "pair.npz"), lambda h, _: h["parts"]["pair"]["fields"].pop("third"))
    assert read(file).third is None


def test_pickles_are_not_read(tmp_path):
    np.savez(tmp_path / "pickle.npz", header=np.array([{"a": 1}], dtype=object))
    with pytest.raises(ValueError, match=r"pickle\.npz: not a file"):
        read(tmp_path / "pickle.npz")


def test_a_function_is_refused_by_name(tmp_path):
    with pytest.raises(TypeError, match=r"pair\.second: a function cannot be saved"):
        pytree_file.write(tmp_path / "pair.npz", {"pair": Pair(jnp.zeros(1), lambda: 0)})
    assert not (tmp_path / "pair.npz").exists()


def test_an_unknown_status_is_named(tmp_path):
    file = tmp_path / "status.npz"
    pytree_file.write(file, {"status": jaxscp.Status.converged})
    assert bool(pytree_file.read(file, "status", []) == jaxscp.Status.converged)
    changed(file, lambda header, arrays: arrays.update(status=np.array("sunny")))
    with pytest.raises(ValueError, match=r"status\.npz: field 'status': 'sunny' is no status"):
        pytree_file.read(file, "status", [])


def test_a_missing_file_says_so(tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere"):
        read(tmp_path / "nowhere.npz")


def test_the_file_is_a_plain_archive(tmp_path):
    assert "header.npy" in zipfile.ZipFile(write(tmp_path / "pair.npz")).namelist()
