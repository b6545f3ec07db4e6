"""Meshes in text: faces, lines and vertices of .obj and .off, and faults in them."""

import numpy as np
import pytest

from jaxscp.corridor import CloudFileError, read_cloud

pytest.importorskip("trimesh", reason="needs the extra clouds")
SQUARE = "v 0 0 0\nv 2 0 0\nv 2 2 0\nv 0 2 0\n"
OFF = "OFF\n4 1 0\n0 0 0\n2 0 0\n2 2 0\n0 2 0\n"


def written(tmp_path, text, suffix="obj"):
    path = tmp_path / f"a.{suffix}"
    path.write_text(text)
    return path


def covers_square(points):
    from scipy.spatial import KDTree

    places = np.random.default_rng(1).uniform(0, 2, (300, 3)) * [1, 1, 0]
    return KDTree(points).query(places)[0].max() < 0.1


@pytest.mark.parametrize(
    "faces",
    [
        "f 1 2 3 4",
        "f -4 -3 -2 -1",
        "f 1/1/1 2/1/1 3/1/1 4/1/1",
        "f 1//1 2//1 3//1 4//1",
        "f 1 2 \\\n3 4",
        "f\t1 2\t3 4 # all",
    ],
)
def test_polygons_of_an_obj_are_read_in_every_way_of_writing(tmp_path, faces):
    assert covers_square(
        read_cloud(written(tmp_path, f"o s\n{SQUARE}vt 0 0\nvn 0 0 1\ng s\n{faces}\n")).points
    )


def test_vertices_of_no_face_are_points(tmp_path):
    cloud = read_cloud(written(tmp_path, f"{SQUARE}f 1 2 3 4\nv 9 9 9\nv 8 8 8\np 5\n"))
    assert covers_square(cloud.points)
    assert cloud.points[-2:].tolist() == [[9, 9, 9], [8, 8, 8]]
    assert cloud.provenance.notes == ("2 vertices of no face are kept as points",)


def test_an_obj_of_vertices_alone_is_a_cloud(tmp_path):
    assert read_cloud(written(tmp_path, SQUARE)).count == 4


@pytest.mark.parametrize("faces", ["", "f 1 2 3\n"])
def test_lines_are_sampled(tmp_path, faces):
    points = read_cloud(
        written(tmp_path, f"{SQUARE}v 0 0 5\nv 4 0 5\nv 4 0 7\n{faces}l 5 6 7\nl 1 2\n")
    ).points
    line = points[points[:, 2] >= 5]
    assert np.diff(np.sort(line[:, 0][line[:, 2] == 5])).max() <= 0.1 + 1e-9
    assert np.diff(np.sort(line[:, 2][line[:, 0] == 4])).max() <= 0.1 + 1e-9
    # No line joins the end of one with the beginning of the next.
    assert not np.any((points[:, 2] > 0) & (points[:, 2] < 5))


def test_faces_with_corners_that_are_not_finite_are_counted(tmp_path):
    text = f"{SQUARE}v nan 0 0\nv inf 0 0\nf 1 2 3 4\nf 1 2 5\n"
    with pytest.warns(UserWarning, match="dropped 1 of") as caught:
        cloud = read_cloud(written(tmp_path, text))
    told = [str(warning.message).split(": ", 1)[1] for warning in caught]
    assert told == [
        "dropped 1 of 3 faces, corners not finite",
        "dropped 1 of 1 vertices of no face, not finite",
    ]
    assert covers_square(cloud.points)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"{SQUARE}f 1 2 99\n", "a face names vertex 99, but there are 4, counted from 1"),
        (f"{SQUARE}l 1 7\n", "a line names vertex 7, but there are 4"),
        (f"{SQUARE}f 1 2 -5\n", "line 5: vertex -5 does not exist, with 4 before it"),
        (f"{SQUARE}f 0 1 2\n", "line 5: vertex 0 does not exist"),
        ("v 0 0\n", "line 1.*'v 0 0'"),
        ("v 0,5 1 2\n", "line 1.*'v 0,5 1 2'"),
        ("0 1 2\n", "no line of it is a vertex"),
        ("v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "no triangle or line with finite corners"),
    ],
)
@pytest.mark.filterwarnings("ignore:.*dropped 1 of 1 faces")
def test_a_wrong_obj_is_told(tmp_path, text, message):
    with pytest.raises(CloudFileError, match=message) as caught:
        read_cloud(written(tmp_path, text))
    assert "a.obj" in str(caught.value)


def test_an_off_is_read_with_its_loose_vertices(tmp_path):
    assert covers_square(read_cloud(written(tmp_path, OFF + "4 0 1 2 3 255 0 0\n", "off")).points)
    cloud = read_cloud(written(tmp_path, OFF.replace("4 1 0", "4 1 0 # some") + "\n3 0 1 2\n", "off"))
    assert [0, 2, 0] in cloud.points.tolist()
    assert read_cloud(written(tmp_path, OFF.replace("4 1 0", "4 0 0"), "off")).count == 4


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (OFF, "counts 4 vertices and 1 faces, but 4 rows follow"),
        (OFF + "4 0 1 2 3\n3 0 1 2\n", "counts 4 vertices and 1 faces, but 6 rows follow"),
        (OFF + "4 0 1 2 9\n", "a face names vertex 9, but there are 4, counted from 0"),
        (OFF + "4 0 1 2\n", "a face of 4 corners names 3"),
        (OFF.replace("2 2 0", "2 two 0") + "3 0 1 2\n", "two"),
        ("OFF BINARY\n", "no counts"),
        ("0 1 2\n", "does not begin with OFF"),
    ],
)
def test_a_wrong_off_is_told(tmp_path, text, message):
    with pytest.raises(CloudFileError, match=message) as caught:
        read_cloud(written(tmp_path, text, "off"))
    assert "a.off" in str(caught.value)
