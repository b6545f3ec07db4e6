"""Triangles of polygons, and samples of surfaces."""

import numpy as np
import pytest

from jaxscp.corridor import read_cloud
from jaxscp.corridor.surfaces import fans


def test_a_fan_keeps_the_area_of_each_polygon():
    rng = np.random.default_rng(0)
    sizes = np.array([3, 2, 5, 4, 1, 5])
    flat = np.arange(sizes.sum())
    angles = np.concatenate([np.sort(rng.uniform(0, 2 * np.pi, size)) for size in sizes])
    corners = np.column_stack([np.cos(angles), np.sin(angles)])
    ends = np.cumsum(sizes)
    expected = 0.0
    for first, last in zip(ends - sizes, ends, strict=True):
        x, y = corners[first:last].T
        expected += 0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))
    (a, b), (c, d) = (corners[fans(flat, sizes)][:, k].T - corners[fans(flat, sizes)][:, 0].T for k in (1, 2))
    assert np.abs(0.5 * (a * d - b * c)).sum() == pytest.approx(expected)
    assert len(fans(flat, sizes)) == np.maximum(sizes - 2, 0).sum()


@pytest.mark.parametrize("element", ["f 1 2 3", "l 1 2 3"])
def test_a_spacing_that_is_not_positive_is_refused(tmp_path, element):
    pytest.importorskip("trimesh", reason="needs the extra clouds")
    (tmp_path / "a.obj").write_text(f"v 0 0 0\nv 1 0 0\nv 1 1 0\n{element}\n")
    with pytest.raises(ValueError, match="spacing must be positive"):
        read_cloud(tmp_path / "a.obj", spacing=0.0)


def test_lines_that_need_too_many_samples_are_refused_before_they_are_made(tmp_path):
    pytest.importorskip("trimesh", reason="needs the extra clouds")
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 9e7 0 0\nl 1 2\n")
    with pytest.raises(ValueError, match=r"a\.obj: lines of 90000000 units need .*--unit mm"):
        read_cloud(tmp_path / "a.obj")
