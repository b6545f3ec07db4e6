"""Files of .ply whose header counts other rows, and vertices that no face names."""

import numpy as np
import pytest

from jaxscp.corridor import CloudFileError, read_cloud

pytest.importorskip("plyfile", reason="needs the extra clouds")
POINTS = np.random.default_rng(0).uniform(-5, 5, size=(40, 3)).astype("<f4")
FACE = "element face 1\nproperty list uchar int vertex_indices\n"


def written(tmp_path, rows, stated, text=True, elements="", after=b""):
    kind = "ascii" if text else "binary_little_endian"
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    head = f"ply\nformat {kind} 1.0\nelement vertex {stated}\n{axes}{elements}end_header\n"
    lines = "".join(f"{x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in rows)
    path = tmp_path / "a.ply"
    path.write_bytes(head.encode() + (lines.encode() if text else rows.tobytes()) + after)
    return path


@pytest.mark.parametrize("text", [True, False])
def test_more_rows_than_the_header_counts_are_refused(tmp_path, text):
    path = written(tmp_path, POINTS, 30, text)
    rest = "10 lines" if text else "120 bytes"
    with pytest.raises(CloudFileError, match=rf"a\.ply: {rest} follow the last row .*30 of 'vertex'"):
        read_cloud(path)


@pytest.mark.parametrize("text", [True, False])
@pytest.mark.parametrize("after", [b"", b"\n", b"\r\n \n"])
def test_blanks_after_the_last_row_are_no_rows(tmp_path, text, after):
    np.testing.assert_allclose(read_cloud(written(tmp_path, POINTS, 40, text, after=after)).points, POINTS)


def test_rows_after_the_last_face_are_refused(tmp_path):
    face = b"\x03" + np.array([0, 1, 2], "<i4").tobytes()
    path = written(tmp_path, POINTS, 40, False, FACE, 2 * face)
    with pytest.raises(CloudFileError, match=r"13 bytes follow the last row .*1 of 'face'"):
        read_cloud(path)


@pytest.mark.parametrize("text", [True, False])
def test_vertices_of_no_face_are_points(tmp_path, text):
    pytest.importorskip("trimesh", reason="needs the extra clouds")
    face = b"3 0 1 2\n" if text else b"\x03" + np.array([0, 1, 2], "<i4").tobytes()
    cloud = read_cloud(written(tmp_path, POINTS, 40, text, FACE, face))
    np.testing.assert_allclose(cloud.points[-37:], POINTS[3:], rtol=1e-6)
    assert cloud.provenance.notes == ("37 vertices of no face are kept as points",)


def test_edges_are_sampled(tmp_path):
    edge = "element edge 1\nproperty int vertex1\nproperty int vertex2\n"
    rows = np.array([[0, 0, 0], [2, 0, 0], [9, 9, 9]], "<f4")
    cloud = read_cloud(written(tmp_path, rows, 3, elements=edge, after=b"0 1\n"), spacing=0.1)
    x = np.sort(cloud.points[:, 0])
    assert np.diff(x[x <= 2]).max() <= 0.1 + 1e-9
    assert [9, 9, 9] in cloud.points.tolist()


def test_faces_with_corners_that_are_not_finite_are_counted(tmp_path):
    pytest.importorskip("trimesh", reason="needs the extra clouds")
    rows = POINTS[:4].copy()
    rows[3] = np.nan
    two = FACE.replace("face 1", "face 2")
    path = written(tmp_path, rows, 4, elements=two, after=b"3 0 1 2\n3 1 2 3\n")
    with pytest.warns(UserWarning, match=r"a\.ply: dropped 1 of 2 faces, corners not finite"):
        assert read_cloud(path).count > 3


def test_positions_in_an_element_that_is_not_read_are_told(tmp_path):
    more = "element points 10\n" + "".join(f"property float {axis}\n" for axis in "xyz")
    path = written(tmp_path, POINTS, 30, elements=more)
    with pytest.warns(UserWarning, match="10 rows of element 'points' have x, y and z"):
        assert read_cloud(path).count == 30
