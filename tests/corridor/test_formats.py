"""Files that other programs write: each made by the library that others use for it."""

import numpy as np
import pytest

from jaxscp.corridor import CloudFileError, FileLayout, read_cloud

from .conftest import quads

POINTS = np.random.default_rng(0).uniform(-5, 5, size=(300, 3)).astype(np.float32)
PCD = """VERSION 0.7
FIELDS x y z
SIZE 4 4 4
TYPE F F F
COUNT 1 1 1
WIDTH 300
HEIGHT 1
VIEWPOINT 0 0 0 1 0 0 0
POINTS 300
DATA binary
"""


def pcd(tmp_path, header=PCD, points=POINTS):
    pytest.importorskip("pypcd4", reason="needs the extra clouds")
    path = tmp_path / "some.pcd"
    path.write_bytes(header.encode() + points.tobytes())
    return path


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("FIELDS x y z", "FIELDS X Y Z"),
        ("VERSION 0.7", "VERSION .5"),
        ("VERSION 0.7", "VERSION 0.6"),
        ("VIEWPOINT 0 0 0 1 0 0 0\n", ""),
        ("COUNT 1 1 1\n", ""),
        ("FIELDS", "COLUMNS"),
        ("POINTS 300\n", ""),
        ("VERSION", "# .PCD v.5 - Point Cloud Data file format\nVERSION"),
        ("WIDTH 300\nHEIGHT 1", "WIDTH 20\nHEIGHT 15"),
        ("DATA binary", "DATA BINARY"),
    ],
)
def test_headers_of_other_writers_are_read(tmp_path, old, new):
    assert old in PCD
    np.testing.assert_array_equal(read_cloud(pcd(tmp_path, PCD.replace(old, new))).points, POINTS)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("SIZE 4 4 4", "SIZE 3 4 4", "field x has TYPE F and SIZE 3"),
        ("TYPE F F F", "TYPE F G F", "field y has TYPE G"),
        ("SIZE 4 4 4", "SIZE 4 4", "SIZE must have one entry for each"),
        ("POINTS 300", "POINTS many", "is not that of a .pcd"),
        ("WIDTH 300\n", "", "is not that of a .pcd|truncated"),
    ],
)
def test_a_wrong_header_names_its_field(tmp_path, old, new, message):
    path = pcd(
        tmp_path, PCD.replace(old, new).replace("POINTS 300\n", "" if "WIDTH" in old else "POINTS 300\n")
    )
    with pytest.raises(CloudFileError, match=message):
        read_cloud(path)


def test_fields_before_and_between_the_coordinates_are_skipped(tmp_path):
    pytest.importorskip("pypcd4", reason="needs the extra clouds")
    rows = np.zeros(
        300, [("n", "<f4", 3), ("x", "<f8"), ("i", "u1"), ("y", "<f4"), ("_", "u1", 2), ("z", "<f4")]
    )
    for k, axis in enumerate("xyz"):
        rows[axis] = POINTS[:, k]
    header = (
        PCD.replace("x y z", "normal x i y _ z")
        .replace("4 4 4", "4 8 1 4 1 4")
        .replace("F F F", "F F U F U F")
    )
    path = pcd(tmp_path, header.replace("COUNT 1 1 1", "COUNT 3 1 1 1 2 1"), rows)
    np.testing.assert_allclose(read_cloud(path).points, POINTS)


@pytest.mark.parametrize("encoding", ["ASCII", "BINARY", "BINARY_COMPRESSED"])
def test_a_cloud_of_pypcd4_with_more_fields_is_read(tmp_path, encoding):
    pypcd4 = pytest.importorskip("pypcd4", reason="needs the extra clouds")
    cloud = pypcd4.PointCloud.from_xyzi_points(np.column_stack([POINTS, np.arange(300.0)]).astype(np.float32))
    cloud.save(str(tmp_path / "a.pcd"), encoding=pypcd4.Encoding[encoding])
    np.testing.assert_allclose(read_cloud(tmp_path / "a.pcd").points, POINTS, atol=1e-5)


def polygons(tmp_path, kind, text=False, order="<", counts=(4,)):
    """The hall as a .ply of triangles, polygons or strips."""
    plyfile = pytest.importorskip("plyfile", reason="needs the extra clouds")
    corners = quads().reshape(-1, 3)
    vertex = np.array([tuple(p) for p in corners], dtype=[("x", "f4"), ("y", "f4"), ("z", "f4")])
    first = 4 * np.arange(len(corners) // 4)
    lists = {
        "triangles": [[k, k + 1, k + 2] for k in first] + [[k, k + 2, k + 3] for k in first],
        "polygons": [[k, k + 1, k + 2, k + 3] for k in first],
        "strips": [[i for k in first for i in (k, k + 1, k + 3, k + 2, -1)]],
        "empty": [],
    }[kind]
    cells = np.empty(len(lists), dtype=[("vertex_indices", object)])
    cells["vertex_indices"] = [np.array(cell, "i4") for cell in lists] or []
    name = "tristrips" if kind == "strips" else "face"
    elements = [plyfile.PlyElement.describe(vertex, "vertex")]
    elements.append(plyfile.PlyElement.describe(cells, name, len_types={"vertex_indices": "u4"}))
    path = tmp_path / f"{kind}.ply"
    plyfile.PlyData(elements, text=text, byte_order="=" if text else order).write(str(path))
    return path


@pytest.mark.parametrize("kind", ["triangles", "polygons", "strips"])
@pytest.mark.parametrize(("text", "order"), [(True, "="), (False, "<"), (False, ">")])
def test_faces_of_a_ply_are_surfaces(tmp_path, kind, text, order):
    pytest.importorskip("trimesh", reason="needs the extra clouds")
    from scipy.spatial import KDTree

    cloud = read_cloud(polygons(tmp_path, kind, text, order))
    rng = np.random.default_rng(1)
    wall = np.column_stack([np.full(400, 2.9), rng.uniform(-3, 1.6, 400), rng.uniform(0, 3, 400)])
    assert KDTree(cloud.points).query(wall)[0].max() < 0.1
    np.testing.assert_allclose(cloud.extent, [[-1, -3, 0], [7, 3, 3]])


def test_a_ply_without_faces_is_a_cloud(tmp_path):
    assert read_cloud(polygons(tmp_path, "empty")).count == len(quads()) * 4


def test_a_face_that_names_no_vertex_is_refused(tmp_path):
    path = polygons(tmp_path, "triangles", text=True)
    path.write_text(path.read_text().rstrip().rsplit(" ", 1)[0] + " 4711\n")
    with pytest.raises(CloudFileError, match="names vertex 4711"):
        read_cloud(path)


@pytest.mark.parametrize("suffix", ["stl", "obj", "off", "glb", "ply"])
def test_meshes_of_trimesh_are_surfaces(tmp_path, suffix):
    trimesh = pytest.importorskip("trimesh", reason="needs the extra clouds")
    from scipy.spatial import KDTree

    mesh = trimesh.Trimesh(*_triangles())
    mesh.export(str(tmp_path / f"hall.{suffix}"))
    cloud = read_cloud(tmp_path / f"hall.{suffix}", spacing=0.2)
    rng = np.random.default_rng(1)
    wall = np.column_stack([np.full(400, 3.1), rng.uniform(-3, 1.6, 400), rng.uniform(0, 3, 400)])
    assert KDTree(cloud.points).query(wall)[0].max() < 0.2


def _triangles():
    corners = quads().reshape(-1, 3)
    first = 4 * np.arange(len(corners) // 4)[:, None]
    return corners, np.concatenate([first + np.array(corner) for corner in ([0, 1, 2], [0, 2, 3])])


def test_an_obj_in_latin_1_with_polygons_is_read(tmp_path):
    pytest.importorskip("trimesh", reason="needs the extra clouds")
    corners = quads().reshape(-1, 3)
    lines = ["# Halle, Wände aus Ziegeln", *(f"v {x} {y} {z}" for x, y, z in corners)]
    lines += [f"f {4 * k + 1} {4 * k + 2} {4 * k + 3} {4 * k + 4}" for k in range(len(corners) // 4)]
    (tmp_path / "hall.obj").write_bytes("\n".join(lines).encode("latin-1"))
    np.testing.assert_allclose(read_cloud(tmp_path / "hall.obj").extent, [[-1, -3, 0], [7, 3, 3]])


def test_a_long_thin_sliver_has_no_hole(tmp_path):
    trimesh = pytest.importorskip("trimesh", reason="needs the extra clouds")
    wire = trimesh.Trimesh([[0, 0, 0], [10, 0, 0], [10, 1e-4, 0]], [[0, 1, 2]], process=False)
    wire.export(str(tmp_path / "wire.stl"))
    x = np.sort(read_cloud(tmp_path / "wire.stl").points[:, 0])
    assert np.diff(x).max() <= 0.1 + 1e-6


@pytest.mark.parametrize("suffix", ["las", "laz"])
def test_scans_of_laspy_are_read_without_noise(tmp_path, suffix):
    laspy = pytest.importorskip("laspy", reason="needs the extra scans")
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.scales, header.offsets = np.full(3, 1e-3), np.array([447300.0, 5412100.0, 310.0])
    scan = laspy.LasData(header)
    scan.x, scan.y, scan.z = (POINTS + header.offsets).T
    scan.classification = np.where(np.arange(300) < 3, 7, 2).astype(np.uint8)
    scan.write(str(tmp_path / f"a.{suffix}"))
    cloud = read_cloud(tmp_path / f"a.{suffix}", offset=header.offsets)
    np.testing.assert_allclose(cloud.points, POINTS[3:], atol=1e-3)
    data = (tmp_path / f"a.{suffix}").read_bytes()
    (tmp_path / f"b.{suffix}").write_bytes(data[: len(data) // 2])
    with pytest.raises(CloudFileError, match=rf"b\.{suffix}"):
        read_cloud(tmp_path / f"b.{suffix}")


def test_scans_of_pye57_are_read(tmp_path):
    pye57 = pytest.importorskip("pye57", reason="needs the extra scans")
    path = tmp_path / "a.e57"
    file = pye57.E57(str(path), mode="w")
    columns = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), POINTS.T.astype(float), strict=True))
    file.write_scan_raw(columns, translation=np.array([1.0, 2.0, 3.0]))
    file.close()
    np.testing.assert_allclose(read_cloud(path).points, POINTS + np.array([1, 2, 3]), atol=1e-5)
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(CloudFileError, match=r"a\.e57"):
        read_cloud(path)


@pytest.mark.parametrize("suffix", ["bt", "ot"])
def test_unknown_cells_of_an_octomap_are_obstacles(tmp_path, suffix):
    octomap = pytest.importorskip("octomap", reason="needs the extra scans")
    tree = octomap.OcTree(0.2)
    for x, y, z in np.stack(np.meshgrid(*[np.arange(-1.9, 2, 0.2)] * 3), -1).reshape(-1, 3):
        tree.updateNode(np.array([x, y, z]), bool(x > 1.8))
    tree.updateInnerOccupancy()
    path = tmp_path / f"a.{suffix}"
    (tree.writeBinary if suffix == "bt" else tree.write)(str(path).encode())
    cloud = read_cloud(path)
    # The cube has one known wall; nobody saw the space beyond its other five sides.
    np.testing.assert_allclose(cloud.extent, [[-2.1, -2.1, -2.1], [1.9, 2.1, 2.1]], atol=1e-6)
    assert cloud.spread == pytest.approx(0.1 * np.sqrt(3))
    assert not np.any(np.all(np.abs(cloud.points) < 1.7, axis=1))
    path.write_bytes(b"something else")
    with pytest.raises(CloudFileError, match="not an OctoMap"):
        read_cloud(path)


def test_occupancy_arrays_need_the_edge_of_their_cells(tmp_path):
    solid = np.zeros((20, 10, 5), bool)
    solid[10] = True
    np.save(tmp_path / "a.npy", solid)
    with pytest.raises(CloudFileError, match=r"FileLayout\(cell="):
        read_cloud(tmp_path / "a.npy")
    cloud = read_cloud(tmp_path / "a.npy", layout=FileLayout(cell=0.5, corner=(1.0, 0.0, 0.0)))
    np.testing.assert_allclose(cloud.extent, [[6.25, 0.25, 0.25], [6.25, 4.75, 2.25]])


@pytest.mark.parametrize("negate", [0, 1])
def test_a_floor_plan_of_ros_becomes_walls_of_a_height(tmp_path, negate):
    pytest.importorskip("yaml", reason="needs the extra scans")
    from PIL import Image

    shades = np.full((20, 30), 254, np.uint8)
    shades[:, 15] = 0
    shades[:, :2] = 205  # unknown
    Image.fromarray(255 - shades if negate else shades).save(tmp_path / "map.pgm")
    text = "image: map.pgm\nresolution: 0.1\norigin: [-1.0, 0.0, 0.0]\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    (tmp_path / "map.yaml").write_text(f"{text}negate: {negate}\n")
    with pytest.raises(CloudFileError, match=r"height=2\.5"):
        read_cloud(tmp_path / "map.yaml")
    cloud = read_cloud(tmp_path / "map.yaml", layout=FileLayout(height=2.0))
    middle = cloud.points[np.abs(cloud.points[:, 2] - 1.0) < 0.06]
    assert {0.55, -0.85} <= set(middle[:, 0].round(2))
    assert cloud.points[:, 2].min() == 0.0
    assert cloud.points[:, 2].max() == 2.0


def test_a_floor_plan_without_its_image_says_so(tmp_path):
    pytest.importorskip("yaml", reason="needs the extra scans")
    (tmp_path / "map.yaml").write_text("image: none.pgm\nresolution: 0.1\norigin: [0, 0, 0]\n")
    with pytest.raises(CloudFileError, match=r"none\.pgm cannot be read"):
        read_cloud(tmp_path / "map.yaml", layout=FileLayout(height=2.0))
    (tmp_path / "map.yaml").write_text("some: thing\n")
    with pytest.raises(CloudFileError, match="no image, resolution, origin"):
        read_cloud(tmp_path / "map.yaml", layout=FileLayout(height=2.0))
