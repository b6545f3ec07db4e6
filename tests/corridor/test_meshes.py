"""Meshes that trimesh reads: counts of triangles, and parts that are no triangle."""

import numpy as np
import pytest

from jaxscp.corridor import CloudFileError, read_cloud

trimesh = pytest.importorskip("trimesh", reason="needs the extra clouds")
BOX = trimesh.creation.box(extents=[2.0, 1.0, 3.0])


def stl(tmp_path, change=lambda data: data, text=False):
    data = (
        trimesh.exchange.stl.export_stl_ascii(BOX).encode() if text else trimesh.exchange.stl.export_stl(BOX)
    )
    path = tmp_path / "a.stl"
    path.write_bytes(change(data))
    return path


@pytest.mark.parametrize("text", [True, False])
def test_a_whole_stl_is_read_in_silence(tmp_path, text):
    np.testing.assert_allclose(read_cloud(stl(tmp_path, text=text)).extent, [[-1, -0.5, -1.5], [1, 0.5, 1.5]])


@pytest.mark.parametrize(
    ("text", "change", "message"),
    [
        (False, lambda d: d[:-60], "states 12 triangles, which need 684 bytes, but the file has 624 bytes"),
        (False, lambda d: d[:300], "states 12 triangles, .* has 300 bytes, room for 4"),
        (False, lambda d: d + b"more", "states 12 triangles, .* has 688 bytes"),
        (False, lambda d: b"solid x" + d[7:-60], "states 12 triangles"),
        (False, lambda d: d[:50], "50 bytes are too few"),
        (True, lambda d: d[: d.rindex(b"endloop")], "12 facets begin, but 11 end"),
        (True, lambda d: d[: d.index(b"endsolid")], "no endsolid after the last of its 12 facets"),
        (True, lambda d: d + d[: d.index(b"endsolid")], "no endsolid after the last of its 24 facets"),
        (True, lambda _: b"solid nothing\nendsolid nothing\n", "holds no triangle"),
    ],
)
def test_an_stl_of_another_length_names_its_triangles(tmp_path, text, change, message):
    with pytest.raises(CloudFileError, match=message):
        read_cloud(stl(tmp_path, change, text))


def test_triangles_of_an_stl_that_are_not_finite_are_counted(tmp_path):
    nan = np.float32(np.nan).tobytes()
    path = stl(tmp_path, lambda data: data[:96] + nan + data[100:])
    with pytest.warns(UserWarning, match=r"a\.stl: dropped 1 of 12 faces, corners not finite"):
        cloud = read_cloud(path)
    np.testing.assert_allclose(cloud.extent, [[-1, -0.5, -1.5], [1, 0.5, 1.5]])


def test_a_mesh_without_a_finite_corner_is_refused(tmp_path):
    every = np.full(9, np.nan, "<f4").tobytes()
    path = stl(tmp_path, lambda d: d[:80] + (1).to_bytes(4, "little") + d[84:96] + every + d[132:134])
    with (
        pytest.warns(UserWarning, match="dropped 1 of 1 faces"),
        pytest.raises(CloudFileError, match="no triangle or line with finite corners"),
    ):
        read_cloud(path)


def test_points_and_ends_of_lines_of_a_gltf_are_kept(tmp_path):
    scene = trimesh.Scene()
    scene.add_geometry(BOX)
    scene.add_geometry(trimesh.PointCloud([[7.0, 0.0, 0.0], [8.0, 0.0, 0.0]]))
    scene.add_geometry(trimesh.load_path([[[0.0, 0.0, 9.0], [2.0, 0.0, 9.0]]]))
    scene.export(str(tmp_path / "a.glb"))
    points = read_cloud(tmp_path / "a.glb", frame="enu").points.tolist()
    for place in ([7, 0, 0], [8, 0, 0], [0, 0, 9], [2, 0, 9]):
        assert place in points


def test_a_wrong_unit_is_not_hidden_by_a_larger_spacing(tmp_path):
    path = tmp_path / "large.stl"
    trimesh.creation.box(extents=[2000.0, 1000.0, 3000.0]).export(str(path))
    with pytest.raises(CloudFileError, match="--unit mm") as caught:
        read_cloud(path)
    assert "--spacing" not in str(caught.value)
    with pytest.raises(CloudFileError, match="--spacing 1"):
        read_cloud(path, unit="m")
