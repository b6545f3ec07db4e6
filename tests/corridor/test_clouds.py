"""Point clouds: dropped points, thinning, warnings, and the messages of bad files."""

import builtins

import numpy as np
import pytest

from jaxscp.corridor import CloudFileError, PointCloud, box, read_cloud

POINTS = np.random.default_rng(0).uniform(-5, 5, size=(300, 3)).astype(np.float32)


def test_points_that_are_not_finite_are_dropped_counted_and_reported():
    with pytest.warns(UserWarning, match="dropped 2 of 4"):
        cloud = PointCloud.of([[0, 0, 0], [np.nan, 0, 0], [0, np.inf, 0], [1, 1, 1]])
    assert (cloud.count, cloud.dropped) == (2, 2)


def test_a_map_of_ten_kilometres_is_suspicious():
    with pytest.warns(UserWarning, match="millimetres"):
        PointCloud.of([[0, 0, 0], [20_000, 0, 0]])


def test_a_wrong_shape_is_named():
    with pytest.raises(ValueError, match=r"\(points, 3\)"):
        PointCloud.of(np.zeros((4, 2)))


def test_an_empty_cloud_is_a_cloud():
    cloud = PointCloud.of([])
    assert cloud.count == 0
    assert cloud.thinned(0.1).count == 0
    assert cloud.without(box([0, 0, 0], [1, 1, 1])).count == 0


@pytest.mark.parametrize("voxel", [0.05, 0.3, 2.0])
def test_every_point_has_one_left_within_the_spread(voxel):
    from scipy.spatial import KDTree

    cloud = PointCloud.of(POINTS)
    thinned = cloud.thinned(voxel)
    assert thinned.count <= cloud.count
    assert thinned.spread <= voxel * np.sqrt(3) / 2 + 1e-12
    assert KDTree(thinned.points).query(cloud.points)[0].max() <= thinned.spread + 1e-12


@pytest.mark.parametrize("voxel", [0.05, 0.3, 2.0])
def test_one_point_a_voxel_is_left_in_the_middle_of_its_points(voxel):
    points = PointCloud.of(POINTS).points
    cells = np.floor((points - points.min(axis=0)) / voxel)
    voxels, of = np.unique(cells, axis=0, return_inverse=True)
    groups = [points[of.ravel() == k] for k in range(len(voxels))]
    expected = [0.5 * (g.min(axis=0) + g.max(axis=0)) for g in groups]
    np.testing.assert_array_equal(PointCloud.of(POINTS).thinned(voxel).points, expected)


def test_spread_adds_up_when_thinned_twice():
    first_order_only = PointCloud.of(POINTS).thinned(0.5)
    assert first_order_only.thinned(1.0).spread >= first_order_only.spread


def test_voxels_far_smaller_than_the_map_are_counted_without_overflow():
    cloud = PointCloud.of([[0, 0, 0], [5000, 5000, 5000], [5000, 5000, 5000]])
    assert cloud.thinned(1e-4).count == 2


def test_two_million_points_are_thinned():
    points = np.random.default_rng(0).uniform(0, 10, size=(2_000_000, 3))
    assert PointCloud.of(points).thinned(0.5).count == 20**3


@pytest.fixture
def written(tmp_path):
    """The same points in every format."""
    pypcd4 = pytest.importorskip("pypcd4", reason="needs the extra clouds")
    plyfile = pytest.importorskip("plyfile", reason="needs the extra clouds")
    cloud = pypcd4.PointCloud.from_xyz_points(POINTS)
    for encoding in pypcd4.Encoding.ASCII, pypcd4.Encoding.BINARY, pypcd4.Encoding.BINARY_COMPRESSED:
        cloud.save(str(tmp_path / f"{encoding.value}.pcd"), encoding=encoding)
    vertex = np.array([tuple(p) for p in POINTS], dtype=[("x", "f4"), ("y", "f4"), ("z", "f4")])
    for text in (True, False):
        element = plyfile.PlyElement.describe(vertex, "vertex")
        plyfile.PlyData([element], text=text).write(str(tmp_path / f"{'text' if text else 'binary'}.ply"))
    np.save(tmp_path / "array.npy", POINTS)
    np.savetxt(tmp_path / "table.xyz", POINTS, header="x y z")
    np.savetxt(tmp_path / "commas.xyz", POINTS, delimiter=",")
    return tmp_path


FILES = ["ascii.pcd", "binary.pcd", "binary_compressed.pcd", "text.ply", "binary.ply", "array.npy"]


@pytest.mark.parametrize("name", [*FILES, "table.xyz", "commas.xyz"])
def test_every_format_reads_back(written, name):
    np.testing.assert_allclose(read_cloud(written / name).points, POINTS, atol=1e-5)


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("share", [0.02, 0.5, 0.97])
def test_a_truncated_file_is_named_with_a_place(written, name, share):
    data = (written / name).read_bytes()
    (written / name).write_bytes(data[: int(share * len(data))])
    with pytest.raises(CloudFileError, match=name.replace(".", r"\.") + r".*(byte|line|header)"):
        read_cloud(written / name)


@pytest.mark.parametrize("suffix", [".pcd", ".ply", ".xyz", ".npy", ".stl", ".obj"])
def test_a_file_of_another_kind_is_told(written, suffix):
    path = written / f"mislabelled{suffix}"
    path.write_bytes(bytes(range(256)) * 20)
    with pytest.raises(CloudFileError, match="mislabelled"):
        read_cloud(path)


def test_a_bad_line_is_numbered(tmp_path):
    path = tmp_path / "table.xyz"
    path.write_text("# x y z\n0 0 0\n1 1 1\n2 two 2\n")
    with pytest.raises(CloudFileError, match=r"line 4.*two"):
        read_cloud(path)


def test_a_short_line_is_numbered(tmp_path):
    path = tmp_path / "table.xyz"
    path.write_text("0 0 0\n1 1\n")
    with pytest.raises(CloudFileError, match="line 2"):
        read_cloud(path)


def test_a_pcd_without_z_says_which_fields_it_has(tmp_path):
    path = tmp_path / "flat.pcd"
    path.write_text(
        "VERSION 0.7\nFIELDS x y\nSIZE 4 4\nTYPE F F\nCOUNT 1 1\nWIDTH 1\nHEIGHT 1\nPOINTS 1\n"
        "DATA ascii\n0 0\n"
    )
    pytest.importorskip("pypcd4", reason="needs the extra clouds")
    with pytest.raises(CloudFileError, match="no field z among FIELDS x y"):
        read_cloud(path)


def test_an_empty_table_is_free_space(tmp_path):
    (tmp_path / "nothing.xyz").write_text("")
    assert read_cloud(tmp_path / "nothing.xyz").count == 0


def test_unknown_suffixes_and_missing_files_are_told(tmp_path):
    (tmp_path / "map.las2").write_text("")
    with pytest.raises(CloudFileError, match=r"known are \.pcd"):
        read_cloud(tmp_path / "map.las2")
    with pytest.raises(FileNotFoundError, match="no such file"):
        read_cloud(tmp_path / "absent.pcd")


@pytest.mark.parametrize("suffix", ["stl", "obj"])
def test_samples_cover_a_mesh(tmp_path, suffix):
    trimesh = pytest.importorskip("trimesh", reason="needs the extra clouds")
    from scipy.spatial import KDTree

    path = tmp_path / f"box.{suffix}"
    trimesh.creation.box(extents=[2.0, 1.0, 3.0]).export(str(path))
    cloud = read_cloud(path, spacing=0.1)
    rng = np.random.default_rng(1)
    face = np.column_stack([np.full(500, 1.0), rng.uniform(-0.5, 0.5, 500), rng.uniform(-1.5, 1.5, 500)])
    assert KDTree(cloud.points).query(face)[0].max() < 0.1
    assert np.abs(cloud.points).max(axis=0) == pytest.approx([1.0, 0.5, 1.5])


def test_a_mesh_in_millimetres_is_suspected_before_memory_runs_out(tmp_path):
    trimesh = pytest.importorskip("trimesh", reason="needs the extra clouds")
    path = tmp_path / "large.stl"
    trimesh.creation.box(extents=[2000.0, 1000.0, 3000.0]).export(str(path))
    with pytest.raises(CloudFileError, match="metres"):
        read_cloud(path)


def test_a_missing_library_names_the_extra(tmp_path, monkeypatch):
    path = tmp_path / "some.pcd"
    path.write_text("VERSION 0.7\nDATA ascii\n")
    real = builtins.__import__

    def blocked(name, *args, **kwargs):
        if name.startswith("pypcd4"):
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr("jaxscp.core.extras.import_module", lambda name: blocked(name))
    with pytest.raises(ImportError, match=r"jaxscp\[clouds\]"):
        read_cloud(path)


@pytest.mark.filterwarnings("ignore::UserWarning", "ignore::RuntimeWarning")
def test_a_numpy_file_with_a_damaged_header_is_refused_or_read(tmp_path):
    """The header is a Python literal: a wrong byte in it is an error of Python's parser, too."""
    np.save(tmp_path / "whole.npy", POINTS)
    content, path = (tmp_path / "whole.npy").read_bytes(), tmp_path / "damaged.npy"
    for at in range(0, len(content) - POINTS.nbytes, 3):
        for wrong in b"(['\\\n\x00\xff9":
            path.write_bytes(content[:at] + bytes([wrong]) + content[at + 1 :])
            try:
                read_cloud(path)
            except ValueError as error:
                assert "damaged.npy" in str(error)  # noqa: PT017


def test_a_count_that_is_no_number_is_refused(tmp_path):
    head = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 /\nWIDTH 1\nHEIGHT 1\nPOINTS 1\nDATA binary\n"
    (tmp_path / "count.pcd").write_bytes(head.encode() + bytes(12))
    with pytest.raises(CloudFileError, match=r"count\.pcd: COUNT must hold whole numbers from 1, has '/'"):
        read_cloud(tmp_path / "count.pcd")
