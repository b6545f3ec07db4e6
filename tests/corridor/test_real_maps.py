"""Recorded clouds and a building's mesh, where a folder of them is at hand."""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

from jaxscp.corridor import NoRoute, Polytope, build_corridor, read_cloud

pytest.importorskip("skimage", reason="needs the extra clouds")

FOLDER = Path(os.environ.get("JAXSCP_MAPS", Path(__file__).parents[3] / "shared" / "maps"))
LEVINE_HALLWAY = ([-1.5, 1.0, 1.0], [12.0, 26.0, 1.2])


# Recorded scans are sparse far from the sensor, and `build_corridor` says so; a building's mesh is not.
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:the map is sparse:UserWarning")
@pytest.mark.parametrize("name", ["levine.stl", "cloud_0917.pcd", "outdoor_scan.pcd"])
def test_a_corridor_through_a_real_map_holds_none_of_its_points(name):
    path = FOLDER / name
    if not path.is_file():
        pytest.skip(f"no {name} in {FOLDER}: set JAXSCP_MAPS to the folder of real maps")
    pytest.importorskip("trimesh" if path.suffix == ".stl" else "pypcd4", reason="needs the extra clouds")
    cloud = read_cloud(path, spacing=0.2)
    low, high = cloud.extent
    rng = np.random.default_rng(0)
    places = rng.uniform(low, np.minimum(high, [np.inf, np.inf, low[2] + 4.0]), size=(500, 3))
    clear = places[np.asarray(KDTree(cloud.points).query(places)[0]) > 0.6]
    # The mesh's rooms are closed: two places at the ends of its hallway, elsewhere any two.
    pairs = [LEVINE_HALLWAY] if path.suffix == ".stl" else clear[:6].reshape(3, 2, 3)
    found = 0
    for start, goal in pairs:
        result = build_corridor(cloud, start, goal, 0.25, lower=low, upper=high)
        if isinstance(result.route, NoRoute):
            continue
        assert result.found, result.message
        assert result.corridor is not None
        for normals, offsets in zip(result.corridor.normals, result.corridor.offsets, strict=True):
            assert cloud.inside(Polytope(normals, offsets), margin=-1e-9).sum() == 0
        found += 1
    assert found >= 1
