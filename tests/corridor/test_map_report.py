"""Maps that contradict their unit, their frame or the flight are refused before a plan; sound ones pass in silence."""

import numpy as np
import pytest

from jaxscp.corridor import MapError, PointCloud, build_corridor, map_report, read_cloud

from .conftest import GOAL, START

FAR = (447300.0, 5412100.0, 310.0)


def on_file(tmp_path, points, name="hall.npy", **reading):
    np.save(tmp_path / name, points)
    return read_cloud(tmp_path / name, **reading)


def refused(cloud, start=START, goal=GOAL, **options):
    """Message of the refusal."""
    with pytest.raises(MapError) as error:
        build_corridor(cloud, start, goal, 0.25, **options)
    return str(error.value)


def test_a_sound_map_is_accepted_without_a_warning(tmp_path, hall):
    report = map_report(on_file(tmp_path, hall), START, GOAL, 0.25)
    assert report.accepted
    assert report.warnings == ()
    assert report.inside == (True, True)
    assert report.spacing == pytest.approx(0.2)
    assert report.assumed == ("unit m", "z up")
    np.testing.assert_allclose(report.upper - report.lower, [8, 6, 3])
    assert "start in the box, goal in the box" in str(report)


@pytest.mark.parametrize("unit", ["mm", "cm", "dm", "km", "in", "ft", "us-ft"])
def test_other_units_than_metres_are_refused_unless_stated(tmp_path, hall, unit):
    from jaxscp.corridor.conventions import UNITS

    stored = hall / UNITS[unit]
    message = refused(on_file(tmp_path, stored))
    assert "hall.npy" in message
    assert "nit" in message
    stated = on_file(tmp_path, stored, unit=unit)
    np.testing.assert_allclose(stated.points, hall, atol=1e-9)
    assert map_report(stated, START, GOAL).accepted


def test_the_refusal_of_a_unit_names_both_lengths(tmp_path, hall):
    message = refused(on_file(tmp_path, 1000 * hall))
    assert "200 m from each other" in message
    assert "radius 0.25 m" in message
    assert "spans 8000 m, the flight 6.01 m" in message
    assert "--unit" in message


def test_an_unknown_unit_lists_the_known_ones(tmp_path, hall):
    with pytest.raises(ValueError, match="unknown unit 'yard'; known are m, dm"):
        on_file(tmp_path, hall, unit="yard")


@pytest.mark.parametrize(
    "offset", [(447300.0, 5412100.0, 310.0), (100.0, 0.0, 0.0), (0.0, 0.0, 40.0), (0.0, 0.0, -40.0)]
)
def test_a_map_elsewhere_is_refused_with_both_boxes(tmp_path, hall, offset):
    cloud = on_file(tmp_path, hall + offset)
    message = refused(cloud)
    assert "start (0, -1.5, 1.5)" in message
    assert "offset" in message
    # Limits about the flight do not make it better.
    assert refused(cloud, lower=[-1, -3, 0], upper=[7, 3, 3])
    moved = on_file(tmp_path, hall + offset, offset=offset)
    np.testing.assert_allclose(moved.points, hall, atol=1e-8)
    assert map_report(moved, START, GOAL).accepted


def test_both_ends_on_one_side_of_the_map_are_refused(tmp_path, hall):
    cloud = on_file(tmp_path, hall + np.array([8.0, 0.0, 0.0]))
    assert "both lie outside the map's box" in refused(cloud)


def test_limits_without_a_point_are_refused(tmp_path, hall):
    outside = {"lower": [-6, -6, 4], "upper": [12, 6, 6]}
    message = refused(on_file(tmp_path, hall), [0, 0, 5], [5, 0, 5], **outside)
    assert "points lies within the limits" in message


@pytest.mark.parametrize("frame", ["ned", "frd"])
def test_a_map_with_z_down_is_refused_unless_its_frame_is_stated(tmp_path, hall, frame):
    from jaxscp.corridor.conventions import FRAMES

    stored = hall @ FRAMES[frame]
    assert "tate" in refused(on_file(tmp_path, stored))
    np.testing.assert_allclose(on_file(tmp_path, stored, frame=frame).points, hall)


def test_the_refusal_of_z_down_names_the_frames(tmp_path, hall):
    message = refused(on_file(tmp_path, hall * [1.0, -1.0, -1.0]), START * [1, 1, 1])
    assert "if z points down" in message
    assert "'ned'" in message


def test_a_mesh_with_y_up_is_refused_or_turned(tmp_path, hall):
    stored = np.column_stack([hall[:, 0], hall[:, 2], -hall[:, 1]])
    assert "tate" in refused(on_file(tmp_path, stored))
    np.testing.assert_allclose(on_file(tmp_path, stored, frame="y-up").points, hall)


def test_an_unknown_frame_lists_the_known_ones(tmp_path, hall):
    with pytest.raises(ValueError, match="unknown frame 'esd'; known are enu"):
        on_file(tmp_path, hall, frame="esd")


def test_a_start_below_the_floor_is_refused_unless_limits_reach_there(tmp_path, hall):
    low = START - [0.0, 0.0, 2.0]
    assert "below the lowest point" in refused(on_file(tmp_path, hall), low)
    assert "below the lowest point" in refused(PointCloud.of(hall), low)
    below = {"lower": [-1, -3, -2], "upper": [7, 3, 3]}
    assert map_report(PointCloud.of(hall), low, GOAL, **below).accepted


def test_all_points_at_one_place_are_no_map(tmp_path):
    assert "points lie at (0, 0, 0)" in refused(on_file(tmp_path, np.zeros((90, 3))), [0, 0, 1], [0.1, 0, 1])


def test_an_array_without_one_finite_point_is_refused():
    with pytest.warns(UserWarning, match="dropped 5 of 5"):
        lost = PointCloud.of(np.full((5, 3), np.nan))
    assert "none of its 5 points is finite" in refused(lost)


def test_a_file_without_a_point_is_refused_and_an_empty_array_is_free_space(tmp_path):
    (tmp_path / "none.xyz").write_text("# x y z\n")
    assert "holds no point" in refused(read_cloud(tmp_path / "none.xyz"))
    report = map_report(PointCloud.of([]), START, GOAL)
    assert report.accepted
    assert "holds no point, so that no obstacle is known" in report.warnings[0]


@pytest.mark.parametrize("value", [np.nan, np.inf, 3.4e38, -1e30])
def test_a_file_without_a_usable_point_is_an_error(tmp_path, value):
    with pytest.raises(ValueError, match=r"hall\.npy: none of its 50 points is usable"):
        on_file(tmp_path, np.full((50, 3), value))


def test_absurd_coordinates_are_dropped_with_a_warning(tmp_path, hall):
    with pytest.warns(UserWarning, match="dropped 1 of"):
        cloud = on_file(tmp_path, np.concatenate([hall, [[1e30, 0, 0]]]))
    np.testing.assert_array_equal(cloud.points, hall)


def test_coordinates_too_coarse_for_their_type_widen_the_radius(tmp_path, hall):
    far = (hall + np.array(FAR)).astype(np.float32)
    with pytest.warns(
        UserWarning, match=r"float32 holds y up to 5412103 in steps of 0\.5 m.*off by up to 0\.25 m"
    ):
        cloud = on_file(tmp_path, far)
    assert cloud.spread == pytest.approx(0.25, abs=2e-3)
    assert on_file(tmp_path, hall.astype(np.float32)).spread == 0.0
    assert on_file(tmp_path, far.astype(float) - far.astype(float)[0]).spread == 0.0


@pytest.mark.parametrize("place", [(9000.0, 9000.0, 9000.0), (0.0, 0.0, -300.0), (40.0, 0.0, 1.0)])
def test_a_stray_point_does_not_widen_the_box(tmp_path, hall, place):
    report = map_report(on_file(tmp_path, np.concatenate([hall, [place]])), START, GOAL)
    assert report.accepted
    assert report.strays == 1
    np.testing.assert_allclose(report.upper, [7, 3, 3])
    np.testing.assert_allclose(report.lower, [-1, -3, 0])
    assert "1 stray points do not widen the map's box" in report.assumed


def test_sparse_points_are_refused_unless_metres_are_stated(tmp_path, hall):
    from .conftest import hall_points

    sparse = hall_points(0.7)
    message = refused(on_file(tmp_path, sparse))
    assert "passes between them" in message
    assert map_report(on_file(tmp_path, sparse, unit="m"), START, GOAL).accepted


@pytest.fixture
def scan(tmp_path, hall):
    """The hall as a .pcd with a VIEWPOINT."""
    pypcd4 = pytest.importorskip("pypcd4", reason="needs the extra clouds")

    def write(points, viewpoint):
        cloud = pypcd4.PointCloud.from_xyz_points(points.astype(np.float32))
        cloud.metadata.viewpoint = viewpoint
        cloud.save(str(tmp_path / "scan.pcd"))
        return tmp_path / "scan.pcd"

    return write


def test_a_viewpoint_that_nothing_explains_is_refused_unless_stated(hall, scan):
    sensor = np.array([0.5, -2.0, 1.0])
    path = scan(hall - sensor, (*sensor, 1.0, 0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match=r"VIEWPOINT 0\.5 -2 1 1 0 0 0.*frame='sensor' or frame='world'"):
        read_cloud(path)
    np.testing.assert_allclose(read_cloud(path, frame="sensor").points, hall, atol=1e-6)
    np.testing.assert_allclose(read_cloud(path, frame="world").points, hall - sensor, atol=1e-6)


def test_a_viewpoint_is_not_applied_where_a_point_lies_at_its_sensor(hall, scan):
    near = hall + np.array([0.05, 0.0, 0.0])
    cloud = read_cloud(scan(near, (0.5, -2.0, 1.0, 1.0, 0.0, 0.0, 0.0)))
    np.testing.assert_allclose(cloud.points, near, atol=1e-6)
    assert "not applied" in cloud.provenance.notes[0]


def test_a_tilted_viewpoint_is_applied_where_that_makes_the_floor_level(hall, scan):
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_euler("xyz", [0.1, -0.07, 0.4])
    sensor = np.array([0.5, -2.0, 1.0])
    x, y, z, w = turn.as_quat()
    path = scan(turn.inv().apply(hall - sensor), (*sensor, w, x, y, z))
    np.testing.assert_allclose(read_cloud(path).points, hall, atol=1e-5)


@pytest.mark.parametrize("pose", [(0, 0, 0, 1, 0, 0, 0), (0, 0, 0, -1, 0, 0, 0)])
def test_an_identity_viewpoint_says_nothing(hall, scan, pose):
    cloud = read_cloud(scan(hall, tuple(float(v) for v in pose)))
    assert cloud.provenance.notes == ()


@pytest.mark.parametrize(
    "pose",
    [
        (0.5, -2.0, 1.0, 0.0, 0.0, 0.0, 0.0),
        (0.5, -2.0, 1.0, 2.0, 0.0, 0.0, 0.0),
        (0.5, -2.0, 1.0, float("nan"), 0.0, 0.0, 1.0),
        (float("inf"), -2.0, 1.0, 1.0, 0.0, 0.0, 0.0),
    ],
)
@pytest.mark.parametrize("frame", [None, "sensor", "ned"])
def test_a_viewpoint_that_is_no_pose_is_refused_unless_it_does_not_count(hall, scan, pose, frame):
    path = scan(hall, pose)
    with pytest.raises(ValueError, match=r"scan\.pcd: VIEWPOINT .* is no pose"):
        read_cloud(path, frame=frame)
    np.testing.assert_allclose(read_cloud(path, frame="world").points, hall, atol=1e-6)


@pytest.mark.parametrize("numbers", ["", "0 0 0", "0 0 0 1 0 0", "0 0 0 1 0 0 0 0", "0 0 0 1 0 0 one"])
def test_a_viewpoint_of_other_than_seven_numbers_is_refused(hall, scan, numbers):
    path = scan(hall, (0.5, -2.0, 1.0, 1.0, 0.0, 0.0, 0.0))
    head, data = path.read_bytes().split(b"VIEWPOINT", 1)
    path.write_bytes(head + b"VIEWPOINT " + numbers.encode() + data[data.index(b"\n") :])
    with pytest.raises(ValueError, match=rf"scan\.pcd: VIEWPOINT {numbers}: must be seven numbers"):
        read_cloud(path)


def test_a_frame_of_a_sensor_needs_a_viewpoint(tmp_path, hall):
    with pytest.raises(ValueError, match="has no VIEWPOINT"):
        on_file(tmp_path, hall, frame="sensor")


def test_the_frame_of_a_gltf_must_be_stated(tmp_path):
    trimesh = pytest.importorskip("trimesh", reason="needs the extra clouds")
    room = trimesh.creation.box(bounds=[[-1, -3, 0], [7, 3, 3]])
    room.export(str(tmp_path / "room.glb"))
    assert "glTF is y up" in refused(read_cloud(tmp_path / "room.glb"))
    assert map_report(read_cloud(tmp_path / "room.glb", frame="enu"), START, GOAL).accepted


def test_an_array_in_millimetres_is_refused_unless_its_unit_is_stated(hall):
    assert "200 m from each other" in refused(PointCloud.of(hall * 1000))
    stated = PointCloud.of(hall * 1000, unit="mm")
    np.testing.assert_allclose(stated.points, hall, atol=1e-9)
    assert not map_report(stated, START, GOAL).warnings


def test_an_array_with_z_down_is_refused_unless_its_frame_is_stated(hall):
    down, goal = hall * [1.0, -1.0, -1.0], [6.0, 1.5, 1.2]
    assert "if z points down" in refused(PointCloud.of(down), START, goal)
    stated = PointCloud.of(down, frame="frd")
    np.testing.assert_allclose(stated.points, hall)
    assert map_report(stated, START, GOAL).accepted


ON_THE_FLOOR = np.array([1.0, 0.0, 0.1]), np.array([6.0, 1.5, 0.1])


def test_ends_on_the_floor_of_a_map_with_z_down_do_not_stand_on_its_roof(hall):
    """Found by random inputs: the plan flew over the map, which is through a wall of the hall."""
    down = hall * [1.0, -1.0, -1.0]
    assert "if z points down" in refused(PointCloud.of(down), *ON_THE_FLOOR)
    assert map_report(PointCloud.of(down, frame="frd"), *ON_THE_FLOOR, 0.25).accepted
    assert map_report(PointCloud.of(down, frame="enu"), *ON_THE_FLOOR, 0.25).accepted


def test_two_decks_above_the_ground_are_accepted():
    """A wrong frame would look alike, if a roof led from deck to deck."""
    deck = np.stack(np.meshgrid(*2 * [np.arange(-0.4, 0.5, 0.1)], [0.0]), axis=-1).reshape(-1, 3)
    field = np.arange(-1, 8, 0.2), np.arange(-3, 4, 0.2), [-2.0]
    ground = np.stack(np.meshgrid(*field), axis=-1).reshape(-1, 3)
    decks = np.concatenate([deck + end * [1.0, 1.0, 0.0] for end in ON_THE_FLOOR])
    report = map_report(PointCloud.of(np.concatenate([decks, ground])), *ON_THE_FLOOR, 0.25)
    assert (report.accepted, report.warnings) == (True, ())


def test_an_array_elsewhere_is_refused_unless_limits_are_stated(hall):
    away = PointCloud.of(hall + FAR)
    assert "Subtract the local origin" in refused(away)
    report = map_report(away, START, GOAL, lower=[-1, -3, 0], upper=[7, 3, 3])
    assert report.accepted
    assert "do not both lie in or near" in report.warnings[0]


def test_an_array_of_a_few_obstacles_may_be_sparse_and_far_away():
    pillars = PointCloud.of([[100.0, 20.0 * row, 1.0] for row in range(40)])
    assert map_report(pillars, START, GOAL).accepted


def test_more_points_than_memory_should_hold_are_refused_before_they_are_read(tmp_path, monkeypatch, hall):
    monkeypatch.setattr("jaxscp.corridor.file_content.MOST_POINTS", 1000)
    with pytest.raises(ValueError, match=rf"{len(hall)} points, more than the 1000 that are read; thin them"):
        on_file(tmp_path, hall)


@pytest.mark.parametrize("which", [0, 1])
def test_one_end_alone_beside_the_map_is_refused(tmp_path, hall, which):
    """0.6 m outside the wall at x = -1 or x = 7; from limits that are stated, the corridor may go there."""
    cloud, ends = on_file(tmp_path, hall), [START, GOAL]
    ends[which] = ends[which] * [0.0, 1.0, 1.0] + ([-1.6, 0.0, 0.0], [7.6, 0.0, 0.0])[which]
    assert f"{('start', 'goal')[which]} lies outside the map's box" in refused(cloud, *ends)
    report = map_report(cloud, *ends, 0.25, lower=[-3, -3, 0], upper=[9, 3, 3])
    assert report.accepted
    assert map_report(cloud, START, GOAL, 0.25).accepted


def test_an_array_whose_first_column_counts_its_points_is_refused(hall):
    assert "a number rather than x" in refused(
        PointCloud.of(np.column_stack([np.arange(len(hall)), hall[:, :2]]))
    )
