"""NumPy files that hold something else than one array of numbers."""

import numpy as np
import pytest

from jaxscp.corridor import CloudFileError, read_cloud

POINTS = np.random.default_rng(0).uniform(-5, 5, size=(40, 3))


def test_a_second_array_in_a_file_is_refused(tmp_path):
    path = tmp_path / "a.npy"
    with path.open("wb") as file:
        np.save(file, POINTS)
        np.save(file, POINTS)
    with pytest.raises(
        CloudFileError, match=r"a\.npy: its array of shape \(40, 3\) ends at byte 1088, .* has 2176"
    ):
        read_cloud(path)


@pytest.mark.parametrize("shape", [(40, 3), (0, 3)])
@pytest.mark.parametrize("order", ["C", "F"])
def test_one_array_is_read_in_every_order(tmp_path, shape, order):
    np.save(tmp_path / "a.npy", np.array(POINTS[: shape[0]], order=order))
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.npy").points, POINTS[: shape[0]])


def test_python_objects_are_refused_without_advice_to_trust_them(tmp_path):
    np.save(tmp_path / "a.npy", POINTS.astype(object), allow_pickle=True)
    with pytest.raises(CloudFileError, match="holds Python objects") as caught:
        read_cloud(tmp_path / "a.npy")
    assert "pickle" not in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"0 1 2\n", b"\x80\x04\x95pickled"])
def test_another_kind_of_content_is_refused_without_advice_to_trust_it(tmp_path, content):
    (tmp_path / "a.npy").write_bytes(content)
    with pytest.raises(CloudFileError, match=f"its {len(content)} bytes do not begin with") as caught:
        read_cloud(tmp_path / "a.npy")
    assert "pickle" not in str(caught.value)
