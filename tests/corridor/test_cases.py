"""The files of the folder of cases: each gives a corridor clear of every solid part, or says why it gives none."""

import contextlib

import numpy as np
import pytest

from jaxscp.corridor import CloudFileError, MapError, PointCloud, build_corridor, read_cloud

from .conftest import GOAL, START, depth_in_solid

pytest.importorskip("skimage", reason="needs the extra clouds")
FAR = (447300.0, 5412100.0, 310.0)
SPARSE = "hall_version_5.pcd", "hall_sparse.xyz"
"""Points farther apart than a vehicle of 25 cm is wide."""


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
    sparse = pytest.warns(
        UserWarning, match=r"sparse: .* up to \d\.\d+ m apart, and a vehicle of radius 0\.25 m"
    )
    with sparse if name in SPARSE else contextlib.nullcontext():
        result = build_corridor(read_cloud(path, **reading), START, GOAL, 0.25)
    assert result.found, result.message
    assert (result.closed_gap > 0.0) == (name in SPARSE)
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


@pytest.mark.parametrize("shift", [(0.5, -2.0, 1.0), (0.0, -1.85, 0.0)])
def test_a_frame_that_puts_the_flight_beside_the_map_is_refused(case, shift):
    """As where a VIEWPOINT is stated not to apply, but does: start and goal lie 0.35 m or more outside of the hall."""
    hall = read_cloud(case("hall.xyz"))
    moved = PointCloud(hall.points - shift, hall.spread, hall.dropped, hall.provenance)
    with pytest.raises(MapError, match="both lie outside the map's box"):
        build_corridor(moved, START, GOAL, 0.25)
    assert build_corridor(hall, START, GOAL, 0.25).found


def test_a_viewpoint_stated_wrongly_is_refused(case):
    pytest.importorskip("pypcd4", reason="needs the extra clouds")
    cloud = read_cloud(case("hall_viewpoint.pcd"), frame="world")
    with pytest.raises(MapError, match=r"hall_viewpoint\.pcd: .*both lie outside .*--frame"):
        build_corridor(cloud, START, GOAL, 0.25)


def test_single_precision_far_from_the_origin_is_warned_of(case):
    pytest.importorskip("pypcd4", reason="needs the extra clouds")
    with pytest.warns(UserWarning, match="off by up to 0.25 m"):
        cloud = read_cloud(case("hall_georeferenced_float32.pcd"))
    np.testing.assert_allclose(cloud.extent[0], np.add([-1, -3, 0], FAR), atol=0.3)
