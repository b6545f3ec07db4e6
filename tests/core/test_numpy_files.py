"""A file is written whole or not at all."""

import errno

import numpy as np
import pytest

from jaxscp.core.numpy_files import replacing


def _write_half(file):
    with replacing(file) as stream:
        stream.write(b"half")
        raise OSError(errno.ENOSPC, "No space left on device")


def test_what_cannot_be_written_whole_leaves_the_old_file(tmp_path):
    file = tmp_path / "plan.npz"
    with replacing(file) as stream:
        np.savez(stream, time=np.arange(3.0))
    with pytest.raises(OSError, match="No space"):
        _write_half(file)
    with np.load(file) as archive:
        np.testing.assert_array_equal(archive["time"], np.arange(3.0))
    assert [path.name for path in tmp_path.iterdir()] == ["plan.npz"]


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "link.npz").symlink_to(tmp_path / "plan.npz")
    with replacing(tmp_path / "link.npz") as stream:
        stream.write(b"new")
    assert (tmp_path / "link.npz").is_symlink()
    assert (tmp_path / "plan.npz").read_bytes() == b"new"
