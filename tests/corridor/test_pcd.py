"""Headers of .pcd files that contradict themselves or the data."""

import numpy as np
import pytest

from jaxscp.corridor import CloudFileError, read_cloud

pytest.importorskip("pypcd4", reason="needs the extra clouds")
POINTS = np.random.default_rng(0).uniform(-5, 5, size=(40, 3)).astype("<f4")


def written(tmp_path, data, **entries):
    head = {
        "VERSION": "0.7",
        "FIELDS": "x y z",
        "SIZE": "4 4 4",
        "TYPE": "F F F",
        "COUNT": "1 1 1",
        "WIDTH": "40",
    }
    head |= {"HEIGHT": "1", "POINTS": "40", "DATA": "binary"} | entries
    path = tmp_path / "a.pcd"
    path.write_bytes("".join(f"{key} {value}\n" for key, value in head.items()).encode() + data)
    return path


@pytest.mark.parametrize("padding", [b"", b"\n", bytes(4096)])
def test_padding_is_no_data(tmp_path, padding):
    np.testing.assert_array_equal(read_cloud(written(tmp_path, POINTS.tobytes() + padding)).points, POINTS)


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"WIDTH": "30", "POINTS": "30"}, "promises 30 points, but data of 10 more follow"),
        ({"WIDTH": "30"}, "WIDTH 30 times HEIGHT 1 is 30, but POINTS is 40"),
        ({"HEIGHT": "2"}, "WIDTH 40 times HEIGHT 2 is 80, but POINTS is 40"),
        ({"WIDTH": "-5", "POINTS": "-5"}, "WIDTH must be a whole number from 0, has '-5'"),
        ({"POINTS": "4.5"}, r"POINTS must be a whole number from 0, has '4\.5'"),
        ({"DATA": "zipped"}, "DATA must be ascii, binary, binary_compressed, has 'zipped'"),
        ({"FIELDS": "x y x"}, "no field z"),
        (
            {"FIELDS": "x y z x", "SIZE": "4 4 4 4", "TYPE": "F F F F", "COUNT": "1 1 1 1"},
            "field x comes twice in FIELDS x y z x",
        ),
    ],
)
def test_a_header_that_contradicts_itself_or_the_data_is_refused_in_one_line(tmp_path, entries, message):
    with pytest.raises(CloudFileError, match=message) as caught:
        read_cloud(written(tmp_path, POINTS.tobytes(), **entries))
    assert "\n" not in str(caught.value)


def test_compressed_data_of_another_number_of_points_are_refused(tmp_path):
    pypcd4 = pytest.importorskip("pypcd4")
    path = tmp_path / "a.pcd"
    pypcd4.PointCloud.from_xyz_points(np.zeros((40, 3), "f4")).save(
        str(path), encoding=pypcd4.Encoding.BINARY_COMPRESSED
    )
    assert read_cloud(path).count == 40
    path.write_bytes(path.read_bytes().replace(b"WIDTH 40", b"WIDTH 30").replace(b"POINTS 40", b"POINTS 30"))
    with pytest.raises(CloudFileError, match="promises 30 points, but the data hold 40"):
        read_cloud(path)
