"""The files of the folder of cases: each gives a corridor clear of every solid part, or says why it gives none."""

import numpy as np
import pytest

from jaxscp.corridor import CloudFileError, MapError, build_corridor, read_cloud

from .conftest import GOAL, START, depth_in_solid

pytest.importorskip("skimage", reason="needs the extra clouds")
FAR = (447300.0, 5412100.0, 310.0)


@pytest.mark.parametrize(
    ("name", "reading"),
    [
        ("hall.xyz", {}),
        ("hall_mesh.ply", {}),
        ("hall_numbered.txt", {}),
        ("hall_outlier.xyz", {}),
        ("hall_upper_case.pcd", {}),
        ("hall_version_5.pcd", {}),
        ("hall_latin1.obj", {}),
        ("hall_millimetres.xyz", {"unit": "mm"}),
        ("hall_sparse.xyz", {"unit": "m"}),
        ("hall_georeferenced.npy", {"offset": FAR}),
        ("hall_viewpoint.pcd", {"frame": "sensor"}),
    ],
)
def test_the_corridor_leads_through_the_gap(case, name, reading):
    path = case(name)
    for suffix, library in ((".pcd", "pypcd4"), (".ply", "plyfile"), (".obj", "trimesh")):
        if path.suffix == suffix:
            pytest.importorskip(library, reason="needs the extra clouds")
    result = build_corridor(read_cloud(path, **reading), START, GOAL, 0.25)
    assert result.found, result.message
    assert result.corridor is not None
    assert depth_in_solid(result.corridor) < 0.0
    assert result.route.points[:, 1].max() > 1.6


@pytest.mark.parametrize(
    ("name", "error", "message"),
    [
        ("hall_millimetres.xyz", MapError, "unit"),
        ("hall_transposed.npy", CloudFileError, "transpose"),
        ("hall_georeferenced.npy", MapError, "offset"),
        ("hall_viewpoint.pcd", CloudFileError, "VIEWPOINT"),
        ("hall_no_returns.pcd", CloudFileError, "none of its 1200 points is usable"),
        ("hall_sparse.xyz", MapError, "passes between them"),
        ("hall_size_three.pcd", CloudFileError, "field x has TYPE F and SIZE 3"),
    ],
)
def test_the_message_names_the_file_and_the_cause(case, name, error, message):
    path = case(name)
    if path.suffix == ".pcd":
        pytest.importorskip("pypcd4", reason="needs the extra clouds")
    with pytest.raises(error, match=f"{name}.*{message}"):
        build_corridor(read_cloud(path), START, GOAL, 0.25)


def test_single_precision_far_from_the_origin_is_warned_of(case):
    pytest.importorskip("pypcd4", reason="needs the extra clouds")
    with pytest.warns(UserWarning, match="off by up to 0.25 m"):
        cloud = read_cloud(case("hall_georeferenced_float32.pcd"))
    np.testing.assert_allclose(cloud.extent[0], np.add([-1, -3, 0], FAR), atol=0.3)
