"""Pictures: the drawn curves, compared with the plan."""

import dataclasses
import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D

import jaxscp
from jaxscp import plot
from jaxscp.core.picture_style import VERMILLION
from jaxscp.plot.curves import SAMPLES

NODES = 20


@pytest.fixture(scope="module")
def scenario():
    return jaxscp.scenarios.ascent_to_platform()


@pytest.fixture(scope="module")
def solution(scenario):
    return jaxscp.Planner(nodes=NODES, method=jaxscp.PTR())(scenario)


@pytest.fixture(scope="module")
def figure(scenario, solution):
    return plot.summary(scenario, solution)


@pytest.fixture(scope="module")
def panels(figure):
    """Two-dimensional axes by their label."""
    return {ax.get_ylabel(): ax for ax in figure.axes if not isinstance(ax, Axes3D)}


@pytest.fixture(scope="module")
def scene(figure):
    return next(ax for ax in figure.axes if isinstance(ax, Axes3D))


def labelled(ax):
    return {line.get_label(): line for line in ax.lines}


def test_every_panel_is_labelled_with_its_unit(panels, scene):
    assert list(panels) == [
        "y [m]",  # of the view from above
        "cost",
        "flight time [s]",
        "largest norm (SI)",
        "speed [m/s]",
        "tilt [deg]",
        "body rate [deg/s]",
        "thrust [N]",
        "clearance [m]",
    ]
    assert panels["clearance [m]"].get_xlabel() == "time [s]"
    assert panels["cost"].get_xlabel() == "iteration"
    assert [scene.get_xlabel(), scene.get_ylabel(), scene.get_zlabel()] == ["x [m]", "y [m]", "z [m]"]


def test_title_says_how_it_ended(figure, solution):
    title = figure.get_suptitle()
    assert title.startswith("converged after")
    assert f"{float(solution.final_time):.2f} s" in title


def test_thrust_limits_are_drawn_and_in_view(panels, scenario):
    ax = panels["thrust [N]"]
    least, most = float(scenario.airframe.thrust_min[0]), float(scenario.airframe.thrust_max[0])
    red = [line for line in ax.lines if to_rgb(line.get_color()) == to_rgb(VERMILLION)]
    levels = sorted(line.get_ydata()[0] for line in red)
    assert levels == [least, most]
    bottom, top = ax.get_ylim()
    assert bottom < least < most < top


def test_clearance_shows_its_limits(panels, scenario):
    lines = labelled(panels["clearance [m]"])
    assert set(lines["limit"].get_ydata()) == {0.0}
    assert set(lines["radius of the hull"].get_ydata()) == {float(scenario.airframe.radius)}


def test_nodes_are_marked_on_the_flown_line(panels, solution):
    lines = labelled(panels["speed [m/s]"])
    time, speed = lines["nodes"].get_data()
    np.testing.assert_allclose(time, solution.trajectory.time)
    sampled = np.interp(time, *lines["integrated"].get_data())
    np.testing.assert_allclose(sampled, speed, atol=0.01)
    assert len(lines["integrated"].get_xdata()) == (NODES - 1) * SAMPLES


def test_convergence_has_one_point_an_iteration(panels, solution):
    count = int(solution.iterations)
    assert panels["largest norm (SI)"].get_yscale() == "log"
    for label in ("cost", "flight time [s]", "largest norm (SI)"):
        for line in panels[label].lines:
            np.testing.assert_array_equal(line.get_xdata(), np.arange(1, count + 1))


def test_scene_shows_all_there_is_to_one_scale(scene, scenario):
    names = {
        "integrated path", "nodes", "corridor", "obstacle points", "landing cone", "start", "goal",
        "body x", "body y", "body z",
    }  # fmt: skip
    assert names <= set(scene.get_legend_handles_labels()[1])
    ranges = np.ptp([scene.get_xlim(), scene.get_ylim(), scene.get_zlim()], axis=1)
    # box_aspect and data ranges have one ratio on all axes: equal scale in all directions
    ratio = np.asarray(scene._box_aspect) / ranges
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-6)


def test_margin_agrees_with_the_certificate(scenario, solution):
    margin = plot.corridor_margin(scenario.corridor, plot.integrated(scenario, solution, samples=200))
    outside = max(-float(margin.min()), 0.0)
    at = solution.certificate.names.index("corridor")
    assert outside == pytest.approx(float(solution.certificate.between_nodes[at]), abs=1e-6)


def test_margin_ignores_padding():
    small, large = (jaxscp.corridor.box([0.0] * 3, [size] * 3) for size in (9.0, 9.5))
    more_faces = eqx.tree_at(
        lambda p: (p.normals, p.offsets), large, (jnp.tile(large.normals, (2, 1)), jnp.tile(large.offsets, 2))
    )
    corridor = jaxscp.corridor.connect([small, more_faces], joints=[[1.0, 1.0, 1.0]])
    curves = plot.Curves(np.zeros(1), np.full((1, 13), 4.5), np.zeros((1, 4)), np.zeros(1, int))
    assert plot.corridor_margin(corridor, curves).tolist() == [4.5]


def curves_through(*points):
    states = np.zeros((len(points), 13))
    states[:, :3] = points
    return plot.Curves(np.zeros(len(points)), states, np.zeros((len(points), 4)), np.zeros(len(points), int))


def test_the_union_has_no_wall_where_polytopes_overlap():
    first = jaxscp.corridor.box([0.0] * 3, [2.0] * 3)
    second = jaxscp.corridor.box([1.0, 0.0, 0.0], [4.0, 2.0, 2.0])
    corridor = jaxscp.corridor.connect([first, second], joints=[[1.5, 1.0, 1.0]])
    curves = curves_through([0.5, 1.0, 1.0], [1.9, 1.0, 1.0], [5.0, 1.0, 1.0])
    np.testing.assert_allclose(plot.union_margin(corridor, curves), [0.5, 0.9, -1.0])


def test_the_margin_of_a_ball_is_the_distance_less_the_radius():
    zones = jaxscp.ellipsoids([[0.0, 0.0, 0.0], [9.0, 0.0, 0.0]], 0.5)
    curves = curves_through([2.0, 1.0, 0.0], [9.0, 0.0, 0.2])
    np.testing.assert_allclose(plot.zone_margin(zones, curves), [np.sqrt(5.0) - 0.5, -0.3])


def test_summary_renders(figure, tmp_path):
    assert isinstance(figure, Figure)
    for name in ("plan.png", "plan.pdf"):
        figure.savefig(tmp_path / name)
        assert (tmp_path / name).stat().st_size > 10_000


@pytest.fixture(scope="module")
def from_file(scenario, solution, tmp_path_factory):
    """Scenario and solution, saved and loaded."""
    file = tmp_path_factory.mktemp("plan") / "plan.npz"
    solution.save(file, scenario)
    return jaxscp.LandingScenario.load(file), jaxscp.Solution.load(file)


def test_a_plan_from_a_file_is_drawn_alike(scenario, solution, figure, from_file):
    for one, other in zip(jax.tree.leaves(from_file), jax.tree.leaves((scenario, solution)), strict=True):
        np.testing.assert_array_equal(one, other)
    again = plot.summary(*from_file)
    assert again.get_suptitle() == figure.get_suptitle()
    lines, expected = (
        [line.get_xydata() for ax in f.axes if not isinstance(ax, Axes3D) for line in ax.lines]
        for f in (again, figure)
    )
    for one, other in zip(lines, expected, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_plan_from_a_file_is_sampled(solution, from_file):
    samples = from_file[1].trajectory.sample(rate=20)
    assert isinstance(samples, jaxscp.FlightSamples)
    np.testing.assert_array_equal(samples.state, solution.trajectory.sample(rate=20).state)
    assert float(jnp.abs(samples.acceleration).max()) > 1.0


@pytest.mark.slow
def test_a_plan_from_a_file_has_the_same_certificate(solution, from_file):
    scenario, found = from_file
    problem, _ = scenario.problem(NODES, context=found.context)
    certificate, expected = jaxscp.certify(problem, found.trajectory), solution.certificate
    assert (certificate.names, certificate.end_names) == (expected.names, expected.end_names)
    for field in ("at_nodes", "between_nodes", "allowed", "end_errors", "end_tolerances", "defect"):
        # of the same integration, compiled as another program
        np.testing.assert_allclose(getattr(certificate, field), getattr(expected, field), rtol=0, atol=1e-9)


def test_drawing_needs_no_obstacles(scenario, solution):
    bare = eqx.tree_at(lambda s: s.obstacles, scenario, None)
    ax = Figure().add_subplot()
    curves = plot.planned(solution)
    plot.draw_clearance(ax, bare, curves, curves)
    assert set(labelled(ax)) & {"centre to obstacles", "radius of the hull"} == set()


def test_limits_zones_and_gates_are_drawn_where_there_are_any(scenario, solution, scene):
    asked = dataclasses.replace(
        scenario,
        limits=jaxscp.flight_limits(speed=4.0, tilt=0.5, body_rate=3.0),
        keep_out=jaxscp.ellipsoids([[5.0, 0.5, 1.6]], [[0.6, 0.6, 1.0]]),
        gates=jaxscp.ellipsoids([[5.0, 0.5, 2.6]], 0.2),
        deck_velocity=jnp.array([0.5, 0.0, 0.0]),
    )
    page = plot.summary(asked, solution)
    panels = {ax.get_ylabel(): labelled(ax) for ax in page.axes if not isinstance(ax, Axes3D)}
    limits = {"speed [m/s]": 4.0, "tilt [deg]": np.degrees(0.5), "body rate [deg/s]": np.degrees(3.0)}
    for label, limit in limits.items():
        np.testing.assert_allclose(panels[label]["limit"].get_ydata(), limit, rtol=1e-6)
    names = next(ax for ax in page.axes if isinstance(ax, Axes3D)).get_legend_handles_labels()[1]
    assert {"keep-out zone", "gate"} <= set(names)
    assert {"keep-out zone", "gate"} & set(scene.get_legend_handles_labels()[1]) == set()


def test_a_moving_deck_is_drawn_where_it_is_met(scenario, solution):
    moving = dataclasses.replace(scenario, deck_velocity=jnp.array([0.5, 0.0, 0.0]))
    page = plot.summary(moving, solution)
    goal = labelled(next(ax for ax in page.axes if isinstance(ax, Axes3D)))["goal"]
    expected = np.asarray(scenario.goal.position) + np.array([0.5, 0.0, 0.0]) * float(solution.final_time)
    np.testing.assert_allclose(np.ravel(goal.get_data_3d()), expected, rtol=1e-6)


def test_plotting_leaves_pyplot_alone():
    code = "import sys, jaxscp.plot; assert 'matplotlib.pyplot' not in sys.modules"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr


def test_importing_the_package_does_not_import_matplotlib():
    code = "import sys, jaxscp; assert 'matplotlib' not in sys.modules"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
