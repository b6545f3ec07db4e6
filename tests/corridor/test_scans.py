"""Files of laser scanners whose header and content disagree."""

import numpy as np
import pytest

from jaxscp.corridor import CloudFileError, read_cloud

laspy = pytest.importorskip("laspy", reason="needs the extra scans")
COUNT = 100
RECORD = 20


def scan(tmp_path, version="1.2", name="a.las"):
    header = laspy.LasHeader(point_format=6 if version == "1.4" else 0, version=version)
    header.scales = np.full(3, 1e-3)
    data = laspy.LasData(header)
    data.x, data.y, data.z = np.random.default_rng(0).uniform(-5, 5, (3, COUNT))
    path = tmp_path / name
    data.write(str(path))
    return path


def test_a_las_that_is_cut_between_records_is_refused(tmp_path):
    path = scan(tmp_path)
    path.write_bytes(path.read_bytes()[: -17 * RECORD])
    with pytest.raises(
        CloudFileError, match=r"a\.las: the header states 100 points, but the file holds 83: cut off"
    ):
        read_cloud(path)


def test_a_las_that_is_cut_within_a_record_is_refused(tmp_path):
    path = scan(tmp_path)
    path.write_bytes(path.read_bytes()[:-7])
    with pytest.raises(CloudFileError, match="states 100 points, but the file holds 99"):
        read_cloud(path)


def test_a_las_with_more_records_than_its_header_states_is_refused(tmp_path):
    path = scan(tmp_path)
    content = bytearray(path.read_bytes())
    content[107:111] = (60).to_bytes(4, "little")
    path.write_bytes(content)
    with pytest.raises(CloudFileError, match="states 60 points, but the file holds 100"):
        read_cloud(path)


def test_zeros_after_the_records_are_no_points(tmp_path):
    path = scan(tmp_path)
    path.write_bytes(path.read_bytes() + bytes(4096))
    assert read_cloud(path).count == COUNT


def test_extended_records_after_the_points_are_no_points(tmp_path):
    path = scan(tmp_path, "1.4")
    data = laspy.read(str(path))
    data.evlrs = laspy.vlrs.vlrlist.VLRList([laspy.VLR("someone", 7, "notes", b"text" * 1000)])
    data.write(str(path))
    assert read_cloud(path).count == COUNT
    content = path.read_bytes()
    path.write_bytes(content[: len(content) - 4500])
    with pytest.raises(CloudFileError, match=r"a\.las"):
        read_cloud(path)


def test_a_laz_that_is_cut_is_refused(tmp_path):
    path = scan(tmp_path, name="a.laz")
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(CloudFileError, match=r"a\.laz"):
        read_cloud(path)
