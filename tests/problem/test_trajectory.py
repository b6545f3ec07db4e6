"""Trajectories: files, and interpolation between the nodes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxscp import DoubleIntegrator, Solution, Trajectory, airframes
from jaxscp.core import pytree_file
from jaxscp.problem.node_values import node_times

NODES = 7
FIELDS = ("time", "state", "control", "dilation")
ROUNDING = 1e-12


def example(seed: int = 0) -> Trajectory:
    """A dilation that changes several-fold, so that scaled time differs much from time."""
    random = np.random.default_rng(seed)
    dilation = jnp.asarray(random.uniform(0.5, 8.0, NODES))
    return Trajectory(
        node_times(dilation),
        jnp.asarray(random.standard_normal((NODES, 13))),
        jnp.asarray(random.uniform(0.3, 5.0, (NODES, 4))),
        dilation,
    )


scaled_time = jax.jit(lambda trajectory, time: trajectory.scaled_time(time))
control_at = jax.jit(lambda trajectory, time: trajectory.control_at(time))
state_at = jax.jit(lambda trajectory, time: trajectory.state_at(time))


def time_at(trajectory: Trajectory, tau: float) -> float:
    """t(tau): the integral of the piecewise linear dilation."""
    nodes = np.linspace(0.0, 1.0, NODES)
    points = np.unique([*nodes[nodes < tau], tau])
    return float(np.trapezoid(np.interp(points, nodes, np.asarray(trajectory.dilation)), points))


# --- between the nodes ---


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 5), st.floats(0.0, 1.0))
def test_scaled_time_inverts_time(seed, tau):
    trajectory = example(seed)
    np.testing.assert_allclose(scaled_time(trajectory, time_at(trajectory, tau)), tau, atol=ROUNDING)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 5), st.floats(0.0, 1.0))
def test_controls_are_linear_in_scaled_time(seed, tau):
    trajectory = example(seed)
    nodes = np.linspace(0.0, 1.0, NODES)
    expected = [np.interp(tau, nodes, column) for column in np.asarray(trajectory.control).T]
    np.testing.assert_allclose(control_at(trajectory, time_at(trajectory, tau)), expected, atol=1e-10)


@pytest.mark.parametrize("node", range(NODES))
def test_nodes_are_met(node):
    trajectory = example()
    np.testing.assert_allclose(
        control_at(trajectory, trajectory.time[node]), trajectory.control[node], atol=1e-10
    )
    np.testing.assert_allclose(
        state_at(trajectory, trajectory.time[node]), trajectory.state[node], atol=1e-10
    )


@pytest.mark.parametrize(("outside", "node"), [(-1.0, 0), (1e3, -1)])
def test_ends_are_held(outside, node):
    trajectory = example()
    np.testing.assert_allclose(control_at(trajectory, outside), trajectory.control[node], atol=ROUNDING)
    np.testing.assert_allclose(state_at(trajectory, outside), trajectory.state[node], atol=ROUNDING)


def test_constant_dilation_is_plain_interpolation():
    trajectory = example()
    dilation = jnp.full(NODES, 3.0)
    even = Trajectory(node_times(dilation), trajectory.state, trajectory.control, dilation)
    np.testing.assert_allclose(scaled_time(even, 1.2), 0.4, atol=ROUNDING)


def test_batch_of_times():
    trajectory = example()
    times = jnp.linspace(0.0, trajectory.time[-1], 9)
    together = jax.vmap(trajectory.control_at)(times)
    np.testing.assert_allclose(together, [control_at(trajectory, t) for t in times], atol=ROUNDING)


@pytest.mark.usefixtures("no_type_checks")
@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            lambda path: path.with_dynamics(DoubleIntegrator(2)),
            r"dynamics: expected \(13, 4\) states and controls",
        ),
        (
            lambda path: path.with_dynamics(airframes.paper_mav().body).at(0.1, steps=2.5),
            r"steps: .* got 2\.5",
        ),
        (lambda path: path.with_dynamics(airframes.paper_mav().body).at(0.1, steps=0), r"steps: .* got 0"),
        (lambda path: path.resampled(1), r"nodes: .* got 1"),
        (lambda path: path.resampled(5.0), r"nodes: .* got 5\.0"),
        (lambda path: path.remainder(1.0), r"first: .* got 1\.0"),
        (lambda path: path.remainder(-0.1), r"first: .* got -0\.1"),
        (lambda path: path.remainder(float("nan")), r"first: .* got nan"),
    ],
)
def test_what_makes_no_sense_of_a_trajectory_is_named(wrong, message):
    with pytest.raises(ValueError, match=message):
        wrong(example())


def test_a_remainder_from_outside_is_nan_inside_jit():
    inside, outside = (jax.jit(lambda path, f: path.remainder(f))(example(), first) for first in (0.5, 1.5))
    np.testing.assert_array_equal(inside.state, example().remainder(0.5).state)
    assert all(jnp.isnan(values).all() for values in (outside.dilation, outside.state, outside.control))


# --- files ---


def test_what_is_saved_is_loaded(tmp_path):
    trajectory = example()
    trajectory.save(tmp_path / "plan.npz")
    loaded = Trajectory.load(tmp_path / "plan.npz")
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(loaded, name), getattr(trajectory, name))


def test_saved_file_has_the_documented_fields(tmp_path):
    example().save(tmp_path / "plan")  # the file name stays unchanged: no suffix from NumPy
    with np.load(tmp_path / "plan") as archive:
        shapes = {name: archive[name].shape for name in archive}
    assert shapes == {
        "time": (NODES,),
        "state": (NODES, 13),
        "control": (NODES, 4),
        "dilation": (NODES,),
    }


@pytest.mark.parametrize("missing", FIELDS)
def test_a_missing_field_is_named(tmp_path, missing):
    arrays = {name: np.asarray(getattr(example(), name)) for name in FIELDS if name != missing}
    np.savez(tmp_path / "part.npz", **arrays)
    with pytest.raises(ValueError, match=missing):
        Trajectory.load(tmp_path / "part.npz")


@pytest.mark.parametrize("short", FIELDS[1:])
def test_a_field_of_another_length_is_named(tmp_path, short):
    arrays = {name: np.asarray(getattr(example(), name)) for name in FIELDS}
    arrays[short] = arrays[short][:-1]
    np.savez(tmp_path / "short.npz", **arrays)
    with pytest.raises(ValueError, match=short):
        Trajectory.load(tmp_path / "short.npz")


@pytest.mark.parametrize(
    ("field", "values"),
    [
        ("time", np.full(NODES, np.nan)),
        ("time", np.arange(NODES, 0, -1.0)),
        ("state", np.full((NODES, 13), "1.0")),
    ],
)
def test_a_field_without_sense_is_named(tmp_path, field, values):
    arrays = {name: np.asarray(getattr(example(), name)) for name in FIELDS}
    np.savez(tmp_path / "strange.npz", **(arrays | {field: values}))
    with pytest.raises(ValueError, match=f"strange.*'{field}'"):
        Trajectory.load(tmp_path / "strange.npz")


@pytest.mark.parametrize("content", [b"", b"not an archive", b"PK\x03\x04 broken"])
def test_a_file_that_is_no_archive_is_named(tmp_path, content):
    file = tmp_path / "noise.npz"
    file.write_bytes(content)
    with pytest.raises(ValueError, match=r"noise\.npz"):
        Trajectory.load(file)


def test_a_file_that_is_not_there_says_so(tmp_path):
    with pytest.raises(FileNotFoundError):
        Trajectory.load(tmp_path / "nowhere.npz")


def test_a_table_says_what_to_load(tmp_path):
    (tmp_path / "plan.csv").write_text("time [s],x [m]\n0.0,1.0\n")
    for load in (Trajectory.load, Solution.load):
        with pytest.raises(
            ValueError, match=r"plan\.csv: .*a table of samples.*Trajectory\.from_arrays"
        ) as caught:
            load(tmp_path / "plan.csv")
        assert "pickle" not in str(caught.value)
    (tmp_path / "noise.npz").write_text("time [s],x [m]\n0.0,1.0\n")
    with pytest.raises(ValueError, match=r"noise\.npz: .*it is no \.npz"):
        Trajectory.load(tmp_path / "noise.npz")


def test_a_file_of_another_class_names_the_function_that_reads_it(tmp_path):
    example().save(tmp_path / "plan.npz")
    with pytest.raises(ValueError, match=r"a trajectory alone: jaxscp\.Trajectory\.load reads it"):
        Solution.load(tmp_path / "plan.npz")
    pytree_file.write(tmp_path / "solution.npz", {"solution": example()})
    with pytest.raises(ValueError, match=r"jaxscp\.Solution\.load\(file\)\.trajectory"):
        Trajectory.load(tmp_path / "solution.npz")


def test_held_controls_stay_held_on_other_nodes():
    """On nodes that contain the old ones, every control is the same; elsewhere it is right at the new nodes."""
    times, controls = np.linspace(0.0, 2.0, 5), np.array([[1.0], [3.0], [-2.0], [5.0], [5.0]])
    line = Trajectory.from_arrays(times, np.zeros((5, 1)), controls)
    held = Trajectory(line.time, line.state, line.control, line.dilation, (0,))
    finer, rest = held.resampled(9), held.remainder(0.1)
    for time in (0.1, 0.45, 0.6, 1.2, 1.9):
        np.testing.assert_array_equal(finer.control_at(time), held.control_at(time))
    for time in np.asarray(rest.time)[:-1]:
        np.testing.assert_array_equal(rest.control_at(time), held.control_at(time + 0.2))
    assert np.all(np.isnan(jax.jit(lambda first: held.remainder(first).control)(1.5)))
