"""Five million points: from the file to the corridor within 5 s and 1 GB, once compiled."""

import resource
import subprocess
import sys
import time

import numpy as np
import pytest

from jaxscp.corridor import CloudFileError, build_corridor, read_cloud

COUNT, SECONDS, BYTES = 5_000_000, 5.0, 1e9
SIZE = np.array([60.0, 40.0, 8.0])
ENDS = [3.0, 20.0, 2.0], [57.0, 20.0, 2.0]


def hall(count):
    """Points on the sides of a hall and on two walls across, each with a gap."""
    rng = np.random.default_rng(0)
    points, which = rng.random((count, 3)) * SIZE, rng.integers(0, 8, count)
    for side in range(6):
        points[which == side, side % 3] = 0.0 if side < 3 else SIZE[side % 3]
    for side, x in ((6, 20.0), (7, 40.0)):
        points[which == side, 0] = x
    points[which == 6, 1] *= 0.8
    points[which == 7, 1] = SIZE[1] - 0.8 * points[which == 7, 1]
    return points + rng.normal(0.0, 0.005, points.shape)


def measured(file):
    """Seconds from file to corridor, the best of three, and peak memory in bytes: for a process of its own."""
    seconds = []
    for _ in range(3):
        began = time.perf_counter()
        result = build_corridor(read_cloud(file), *ENDS, 0.25)
        seconds.append(time.perf_counter() - began)
        assert result.found, result.message
    return min(seconds), 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


@pytest.mark.nightly
def test_five_million_points_take_five_seconds_and_a_gigabyte(tmp_path):
    pytest.importorskip("skimage", reason="needs the extra clouds")
    np.save(tmp_path / "hall.npy", hall(COUNT))
    code = (
        "import jax, sys; jax.config.update('jax_enable_x64', True); "
        "from tests.corridor.test_large_maps import measured; print(*measured(sys.argv[1]))"
    )
    run = [sys.executable, "-c", code, str(tmp_path / "hall.npy")]
    done = subprocess.run(run, capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stderr
    seconds, memory = map(float, done.stdout.split())
    assert memory <= BYTES
    assert seconds <= SECONDS


def test_forty_million_points_are_refused_with_the_remedy(tmp_path):
    """The file is a hole on the disk: it is refused by its header, and none of it is read."""
    stored = np.lib.format.open_memmap(tmp_path / "large.npy", "w+", np.float32, (40_000_000, 3))
    del stored
    with pytest.raises(CloudFileError, match=r"large\.npy: 40000000 points, .*voxel"):
        read_cloud(tmp_path / "large.npy")
