"""Units in the header of a table."""

import numpy as np
import pytest

from jaxscp.corridor import CloudFileError, FileLayout, read_cloud

ROWS = "1,2,3\n4,5,6\n"


def written(tmp_path, header):
    (tmp_path / "a.csv").write_text(f"{header}\n{ROWS}")
    return tmp_path / "a.csv"


@pytest.mark.parametrize("header", ["X (m),Y (m),Z (cm)", "x,y,z_cm", "x_mm,y,z"])
def test_columns_of_different_units_are_refused_by_their_names(tmp_path, header):
    path = written(tmp_path, header)
    listed = header.replace(",", ", ").replace("(", r"\(").replace(")", r"\)")
    with pytest.raises(CloudFileError, match=rf"a\.csv: columns {listed} have different units"):
        read_cloud(path)
    with pytest.raises(CloudFileError, match="different units"):
        read_cloud(path, layout=FileLayout(columns=(0, 1, 2)))


@pytest.mark.parametrize(
    ("header", "scale"), [("x,y,z_m", 1.0), ("x_cm,y_cm,z_cm", 0.01), ("X (ft),Y (ft),Z (ft)", 0.3048)]
)
def test_columns_of_one_unit_are_read(tmp_path, header, scale):
    np.testing.assert_allclose(
        read_cloud(written(tmp_path, header)).points, scale * np.array([[1, 2, 3], [4, 5, 6]])
    )


def test_units_of_other_columns_do_not_matter(tmp_path):
    (tmp_path / "a.csv").write_text("x_m,y_m,z_m,width_mm\n1,2,3,4\n")
    assert read_cloud(tmp_path / "a.csv").points.tolist() == [[1, 2, 3]]
