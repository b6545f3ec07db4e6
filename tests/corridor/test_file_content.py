"""Files under the suffix of another kind."""

import gzip
import io
import zipfile

import numpy as np
import pytest

from jaxscp.corridor import CloudFileError, read_cloud


def array_bytes():
    file = io.BytesIO()
    np.save(file, np.zeros((5, 3)))
    return file.getvalue()


def zip_bytes():
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("a.xyz", "0 0 0\n")
    return file.getvalue()


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.xyz", array_bytes(), r"looks like a NumPy array under another name; rename it to \.npy"),
        ("a.stl", array_bytes(), r"looks like a NumPy array"),
        ("a.xyz", gzip.compress(b"0 0 0\n"), "compressed by gzip under another name; unpack it first"),
        ("a.npy", zip_bytes(), r"looks like a \.zip or \.npz archive"),
        (
            "a.txt",
            b"ply\nformat ascii 1.0\n",
            r"looks like a \.ply file under another name; rename it to \.ply",
        ),
        ("a.csv", b"# .PCD v0.7\n", r"rename it to \.pcd"),
        ("a.xyz", b"LASF" + bytes(300), r"rename it to \.las or \.laz"),
    ],
    ids=["npy", "npy as mesh", "gzip", "zip", "ply", "pcd", "las"],  # contents hold the time
)
def test_a_known_kind_under_another_name_is_told(tmp_path, name, content, message):
    path = tmp_path / name
    path.write_bytes(content)
    if path.suffix == ".stl":
        pytest.importorskip("trimesh", reason="needs the extra clouds")
    with pytest.raises(CloudFileError, match=message) as caught:
        read_cloud(path)
    assert name in str(caught.value)
