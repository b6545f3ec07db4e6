"""Text tables and arrays: headers, separators, encodings, and columns that are no coordinates."""

import numpy as np
import pytest

from jaxscp.corridor import CloudFileError, FileLayout, read_cloud

POINTS = np.random.default_rng(0).uniform(-5, 5, size=(40, 3)).round(3)


def written(tmp_path, name, rows, header="", separator=" ", encoding="utf-8"):
    lines = [separator.join(f"{value:g}" for value in row) for row in rows]
    path = tmp_path / name
    path.write_text("\n".join([header, *lines] if header else lines) + "\n", encoding=encoding)
    return path


@pytest.mark.parametrize(
    "header", ["x,y,z", '"X","Y","Z"', "# x y z", "//X Y Z", "Points:0,Points:1,Points:2"]
)
def test_headers_of_three_columns_are_understood(tmp_path, header):
    path = written(tmp_path, "t.csv", POINTS, header, ",")
    np.testing.assert_allclose(read_cloud(path).points, POINTS)


@pytest.mark.parametrize(
    ("name", "separator"), [("a.txt", "\t"), ("a.csv", ";"), ("a.asc", ", "), ("a.xyz", "   ")]
)
def test_separators_are_found(tmp_path, name, separator):
    rows = np.column_stack([POINTS, np.full(40, 7.5)])
    np.testing.assert_allclose(read_cloud(written(tmp_path, name, rows, "", separator)).points, POINTS)


def test_columns_are_found_by_their_names_wherever_they_are(tmp_path):
    rows = np.column_stack([np.arange(40), POINTS[:, 2], np.full(40, 9), POINTS[:, 0], POINTS[:, 1]])
    path = written(tmp_path, "t.csv", rows, "id,Z [m],intensity,X [m],Y [m]", ",")
    np.testing.assert_allclose(read_cloud(path).points, POINTS)


def test_a_header_states_the_unit_and_the_frame(tmp_path):
    cloud = read_cloud(written(tmp_path, "t.csv", 1000 * POINTS, "x[mm];y[mm];z[mm]", ";"))
    np.testing.assert_allclose(cloud.points, POINTS)
    assert cloud.provenance.unit == "mm"
    down = read_cloud(written(tmp_path, "d.csv", POINTS, "north,east,down", ","))
    np.testing.assert_allclose(down.points, POINTS[:, [1, 0, 2]] * [1, 1, -1])
    assert down.provenance.frame == "ned"


def test_degrees_are_refused(tmp_path):
    with pytest.raises(CloudFileError, match="degrees are no metres"):
        read_cloud(written(tmp_path, "t.csv", POINTS, "lat,lon,alt", ","))


def test_a_decimal_comma_is_understood(tmp_path):
    path = tmp_path / "t.txt"
    path.write_text("\n".join(" ".join(f"{v:.3f}".replace(".", ",") for v in row) for row in POINTS))
    np.testing.assert_allclose(read_cloud(path).points, POINTS)
    path.write_text("\n".join(";".join(f"{v:.3f}".replace(".", ",") for v in row) for row in POINTS))
    np.testing.assert_allclose(read_cloud(path).points, POINTS)


@pytest.mark.parametrize("encoding", ["latin-1", "utf-8-sig", "utf-16"])
def test_encodings_are_found(tmp_path, encoding):
    path = tmp_path / "t.txt"
    path.write_bytes(
        "# Wände\n".encode(encoding) + "0 1 2\n3 4 5\n".encode("utf-16-le" if "16" in encoding else "ascii")
    )
    assert read_cloud(path).points.tolist() == [[0, 1, 2], [3, 4, 5]]


def test_a_pts_file_begins_with_its_number_of_points(tmp_path):
    rows = np.column_stack([POINTS, np.full((40, 4), 128)])
    np.testing.assert_allclose(read_cloud(written(tmp_path, "t.pts", rows, "40")).points, POINTS)


@pytest.mark.parametrize("begin", [0, 1])
def test_a_column_that_counts_is_not_x(tmp_path, begin):
    rows = np.column_stack([begin + np.arange(40), POINTS])
    cloud = read_cloud(written(tmp_path, "t.txt", rows))
    np.testing.assert_allclose(cloud.points, POINTS)
    assert "counts points" in cloud.provenance.notes[0]
    np.save(tmp_path / "t.npy", rows)
    np.testing.assert_allclose(read_cloud(tmp_path / "t.npy").points, POINTS)


@pytest.mark.parametrize("first", [np.arange(40) * 3.0 + 17, 1e9 + 0.01 * np.arange(40)])
def test_a_number_or_a_time_before_x_is_refused_unless_columns_are_stated(tmp_path, first):
    np.save(tmp_path / "t.npy", np.column_stack([first, POINTS]))
    with pytest.raises(CloudFileError, match=r"t\.npy.*a number or a time.*columns=\(1, 2, 3\)"):
        read_cloud(tmp_path / "t.npy")
    stated = read_cloud(tmp_path / "t.npy", layout=FileLayout(columns=(1, 2, 3)))
    np.testing.assert_allclose(stated.points, POINTS)


def test_colours_before_x_are_refused(tmp_path):
    rows = np.column_stack([np.random.default_rng(1).integers(0, 256, (40, 3)), POINTS])
    with pytest.raises(CloudFileError, match="a colour rather than a position"):
        read_cloud(written(tmp_path, "t.xyz", rows))


def test_more_columns_after_x_y_z_are_read_in_silence(tmp_path):
    rows = np.column_stack([POINTS, np.arange(40), np.full(40, 200), np.full(40, 100)])
    np.testing.assert_allclose(read_cloud(written(tmp_path, "t.xyz", rows)).points, POINTS)


def test_a_transposed_array_is_refused_with_the_transpose(tmp_path):
    np.save(tmp_path / "t.npy", POINTS.T)
    with pytest.raises(CloudFileError, match=r"shape \(3, 40\).*points\.T"):
        read_cloud(tmp_path / "t.npy")


def test_arrays_with_names_and_images_of_points_are_read(tmp_path):
    named = np.array([tuple(p) for p in POINTS[:, ::-1]], dtype=[("z", "f8"), ("y", "f8"), ("x", "f8")])
    np.save(tmp_path / "named.npy", named)
    np.testing.assert_allclose(read_cloud(tmp_path / "named.npy").points, POINTS)
    np.save(tmp_path / "image.npy", POINTS.reshape(8, 5, 3))
    np.testing.assert_allclose(read_cloud(tmp_path / "image.npy").points, POINTS)


def test_a_column_that_is_not_there_is_named(tmp_path):
    path = written(tmp_path, "t.csv", POINTS, "x,y,z", ",")
    with pytest.raises(CloudFileError, match="no column 'w'"):
        read_cloud(path, layout=FileLayout(columns=("x", "y", "w")))


@pytest.mark.parametrize("suffix", ["pts", "xyz"])
@pytest.mark.parametrize(("stated", "cause"), [(50, "cut off"), (30, "rows were added")])
def test_a_number_of_points_that_is_not_that_of_the_rows_is_refused(tmp_path, suffix, stated, cause):
    path = written(tmp_path, f"t.{suffix}", POINTS, str(stated))
    with pytest.raises(CloudFileError, match=rf"states {stated} points, but 40 rows follow: {cause}"):
        read_cloud(path)


def test_blank_lines_and_comments_are_no_rows(tmp_path):
    (tmp_path / "t.pts").write_text("\n2\n# comment\n0 1 2\n\nnan nan nan\n\n")
    with pytest.warns(UserWarning, match="dropped 1 of 2 points"):
        assert read_cloud(tmp_path / "t.pts").points.tolist() == [[0, 1, 2]]
