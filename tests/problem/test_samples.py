"""Samples of a trajectory: compared with SciPy, with differences, and with closed forms."""

import csv
import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

import jaxscp as js
from jaxscp.problem.node_values import node_times

NODES = 5
INTEGRATION = (
    1e-9  # of smooth dynamics over one interval in 20 steps of sixth order; SciPy's tolerance is 1e-12
)
ROUNDING = 1e-12
STEP, DIFFERENCES = (
    1e-4,
    1e-5,
)  # of central differences: their error is of second order, times third derivatives
BODY = js.airframes.paper_mav().body


def pendulum(x, u, t, p):
    """Damped, driven in time, with one control that is held and one that is linear."""
    return jnp.stack([x[1], -p["gravity"] * jnp.sin(x[0]) - 0.3 * x[1] + u[0] * jnp.cos(t) + u[1]])


PENDULUM = js.Dynamics.of(pendulum, 2, 2, {"gravity": jnp.array(9.81)})


def trajectory(dynamics, start, controls, hold=(), dilation=None):
    """Nodes from arrays; only the first state of an interval matters, and any will do."""
    random = np.random.default_rng(3)
    dilation = jnp.asarray(random.uniform(1.0, 3.0, NODES) if dilation is None else dilation)
    states = jnp.asarray(np.asarray(start) + 0.1 * random.standard_normal((NODES, len(start))))
    return js.Trajectory(node_times(dilation), states, jnp.asarray(controls), dilation, hold, dynamics)


@pytest.fixture(scope="module")
def swing():
    controls = np.random.default_rng(0).standard_normal((NODES, 2))
    return trajectory(PENDULUM, [0.3, -0.2], controls, hold=(0,))


@pytest.fixture(scope="module")
def flight():
    level = np.eye(13)[6]
    thrusts = float(BODY.hover_thrust()[0]) * (
        1.0 + 0.2 * np.random.default_rng(1).standard_normal((NODES, 4))
    )
    return trajectory(BODY, level, thrusts)


def by_scipy(path, time):
    """The state by DOP853 in scaled time, and the controls; written anew from the nodes."""
    nodes, s, u = np.asarray(path.time), np.asarray(path.dilation), np.asarray(path.control)
    i, width = min(int(np.searchsorted(nodes, time, side="right")) - 1, NODES - 2), 1.0 / (NODES - 1)
    elapsed = lambda f: width * (s[i] * f + 0.5 * (s[i + 1] - s[i]) * f**2)  # noqa: E731
    fraction = brentq(lambda f: nodes[i] + elapsed(f) - time, -1e-9, 1.0 + 1e-9, xtol=1e-15)
    last = u[i + 1].copy()
    last[list(path.zero_order_hold)] = u[i, list(path.zero_order_hold)]
    control = lambda f: u[i] + f * (last - u[i])  # noqa: E731
    slope = jax.jit(lambda x, u, t: path.dynamics(x, u, t))

    def rate(f, x):
        return (
            width * (s[i] + f * (s[i + 1] - s[i])) * np.asarray(slope(x, control(f), nodes[i] + elapsed(f)))
        )

    start = np.asarray(path.state[i])
    if abs(fraction) < 1e-8:
        return start, control(fraction)
    found = solve_ivp(rate, (0.0, fraction), start, method="DOP853", rtol=1e-12, atol=1e-12)
    return found.y[:, -1], control(fraction)


@pytest.mark.parametrize("name", ["swing", "flight"])
def test_states_are_those_of_the_integrated_controls(name, request):
    path = request.getfixturevalue(name)
    times = np.linspace(0.0, float(path.time[-1]), 6)[1:]
    samples = path.at(times)
    for number, time in enumerate(times):
        state, control = by_scipy(path, time)
        np.testing.assert_allclose(samples.state[number], state, rtol=0, atol=INTEGRATION)
        np.testing.assert_allclose(samples.control[number], control, rtol=0, atol=1e-8)
        rate = path.dynamics(samples.state[number], samples.control[number], time)
        np.testing.assert_allclose(samples.state_rate[number], rate, rtol=0, atol=ROUNDING)


def test_nodes_are_met(swing):
    samples = swing.at(swing.time[:-1])
    np.testing.assert_allclose(samples.state, swing.state[:-1], rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(samples.control, swing.control[:-1], rtol=0, atol=ROUNDING)


def test_a_held_control_keeps_its_value(swing):
    before = swing.at(swing.time[1:] - 1e-6).control
    np.testing.assert_allclose(before[:, 0], swing.control[:-1, 0], rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(before[:, 1], swing.control[1:, 1], rtol=0, atol=1e-5)


def test_parts_of_a_flight_are_derivatives_of_each_other(flight):
    middle = 0.5 * (flight.time[1:] + flight.time[:-1])
    now, before, after = (flight.at(middle + by) for by in (0.0, -STEP, STEP))
    assert isinstance(now, js.FlightSamples)
    slope = lambda part: (getattr(after, part) - getattr(before, part)) / (2.0 * STEP)  # noqa: E731
    np.testing.assert_allclose(slope("position"), now.velocity, atol=DIFFERENCES)
    np.testing.assert_allclose(slope("velocity"), now.acceleration, atol=DIFFERENCES)
    np.testing.assert_allclose(slope("body_rate"), now.angular_acceleration, atol=1e-3, rtol=DIFFERENCES)
    np.testing.assert_allclose(now.speed, np.linalg.norm(now.velocity, axis=1))
    up = Rotation.from_quat(np.asarray(now.attitude), scalar_first=True).apply([0.0, 0.0, 1.0])[:, 2]
    np.testing.assert_allclose(now.tilt, np.arccos(np.clip(up, -1.0, 1.0)), atol=1e-6)
    norm = jnp.linalg.norm(now.attitude, axis=1) / jnp.linalg.norm(flight.state[:-1, 6:10], axis=1)
    np.testing.assert_allclose(norm, 1.0, atol=INTEGRATION)  # the dynamics keep the norm


def test_derivatives_are_those_of_differences(swing):
    """In the time, in a parameter of the dynamics, and in a node's control."""
    time = 0.6 * swing.time[-1]

    def angle(time, gravity, push):
        dynamics = dataclasses.replace(PENDULUM, parameters={"gravity": gravity})
        moved = js.Trajectory(
            swing.time, swing.state, swing.control.at[2, 1].add(push), swing.dilation, (0,), dynamics
        )
        return moved.at(time).state[0]

    at = time, jnp.array(9.81), jnp.array(0.0)
    value = jax.jit(angle)
    for number, slope in enumerate(jax.jit(jax.grad(angle, argnums=(0, 1, 2)))(*at)):
        either = [value(*(v + sign * STEP * (i == number) for i, v in enumerate(at))) for sign in (1.0, -1.0)]
        difference = (either[0] - either[1]) / (2.0 * STEP)
        np.testing.assert_allclose(slope, difference, atol=DIFFERENCES)


def test_jit_and_vmap(swing):
    times = jnp.linspace(0.0, swing.time[-1], 4)
    expected = swing.at(times).state
    together = jax.vmap(lambda t: swing.at(t).state)(times)
    np.testing.assert_allclose(together, expected, rtol=0, atol=ROUNDING)
    batch = jax.tree.map(lambda v: jnp.stack([v, v]), swing)
    both = jax.jit(jax.vmap(lambda path: path.at(times).state))(batch)
    np.testing.assert_allclose(both, jnp.stack([expected, expected]), rtol=0, atol=ROUNDING)
    with pytest.raises(ValueError, match=r"is a batch.*jax\.vmap"):
        batch.at(times)
    with pytest.raises(ValueError, match=r"is a batch.*jax\.vmap"):
        batch.sample(rate=1.0)


def test_a_problems_own_program_is_the_function(swing):
    """A solution's dynamics are a program of the user's function."""
    from jaxscp.problem.canonical import canonical

    free = js.fixed_state([None, None])
    problem = js.OptimalControlProblem(
        PENDULUM, js.Cost(), js.Boundary(free, free), js.Time(NODES, js.FreeTime(1.0, 3.0))
    )
    found = swing.with_dynamics(canonical(problem).dynamics).at([0.7]).state
    np.testing.assert_allclose(found, swing.at([0.7]).state, rtol=0, atol=ROUNDING)


# --- times ---


def drive(duration=2.0):
    """At an acceleration of 1 m/s^2 from rest."""
    ends = [[0.0, 0.0], [0.5 * duration**2, duration]]
    path = js.Trajectory.from_arrays([0.0, duration], ends, [[1.0], [1.0]])
    return path.with_dynamics(js.DoubleIntegrator(1))


@pytest.mark.parametrize(("duration", "rate", "count"), [(2.0, 10, 21), (2.3, 100, 231), (2.05, 10, 21)])
def test_samples_are_equally_spaced_from_the_start(duration, rate, count):
    samples = drive(duration).sample(rate=rate)
    np.testing.assert_allclose(samples.time, np.arange(count) / rate, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(samples.state[:, 0], 0.5 * samples.time**2, rtol=0, atol=ROUNDING)


@pytest.mark.parametrize(
    ("duration", "count"), [(3.311, 333), (9.99999963, 1001), (2.0000002, 201), (2.3, 231), (0.001, 2)]
)
def test_the_end_is_a_sample_where_asked_for(duration, count, tmp_path):
    path = drive(duration)
    samples = path.sample(rate=100, end=True)
    assert len(samples.time) == count
    assert float(samples.time[-1]) == duration
    np.testing.assert_allclose(samples.state[-1], path.state[-1], rtol=0, atol=ROUNDING)
    samples.to_csv(tmp_path / "drive.csv")
    assert table(tmp_path / "drive.csv")[1][-1, 0] == duration


def test_an_integral_over_scaled_time_reaches_the_end(swing):
    """As a user integrates: controls and dilation are linear in scaled time, on a mesh that is far from even."""
    tau = np.linspace(0.0, 1.0, NODES)
    at = lambda values, s: np.array([np.interp(s, tau, column) for column in np.atleast_2d(values.T)])  # noqa: E731
    linear = js.Trajectory(swing.time, swing.state, swing.control, swing.dilation, (), PENDULUM)
    slope = jax.jit(lambda x, u, t: PENDULUM(x, u, t))

    def rate(s, y):  # the last entry is the time
        grows = slope(y[:-1], at(np.asarray(linear.control), s), y[-1])
        return at(np.asarray(linear.dilation), s)[0] * np.append(grows, 1.0)

    y = np.append(linear.state[-2], linear.time[-2])
    found = solve_ivp(rate, tau[-2:], y, method="DOP853", rtol=1e-11, atol=1e-11).y[:, -1]
    np.testing.assert_allclose(found[:-1], linear.at(linear.time[-1]).state, rtol=0, atol=INTEGRATION)
    np.testing.assert_allclose(found[-1], linear.time[-1], rtol=0, atol=INTEGRATION)


def test_a_time_outside_is_an_error_and_nan_inside_jit():
    path = drive()
    for time in (-0.1, 2.1, float("nan")):
        with pytest.raises(ValueError, match=r"is outside the trajectory, from 0 s to 2 s"):
            path.at([1.0, time])
    inside = jax.jit(lambda t: path.at(t).state[:, 0])(jnp.array([-0.1, 1.0, 2.0, 2.1]))
    np.testing.assert_array_equal(jnp.isnan(inside), [True, False, False, True])
    np.testing.assert_allclose(path.at(2.0 + 1e-12).state, [2.0, 2.0], rtol=0, atol=ROUNDING)


def test_what_cannot_be_sampled_says_why():
    path = drive()
    with pytest.raises(TypeError, match=r"Call trajectory\.at\(times\)"):
        jax.jit(lambda p: p.sample(rate=10.0).state)(path)
    with pytest.raises(ValueError, match=r"trajectory\.with_dynamics\(problem\.dynamics\)"):
        path.with_dynamics(None).sample(rate=10.0)
    with pytest.raises(ValueError, match=r"rate: a positive number"):
        path.sample(rate=0.0)
    with pytest.raises(ValueError, match=r"rate: 1e\+12 Hz would make 2e\+12 samples"):
        path.sample(rate=1e12)
    with pytest.raises(ValueError, match=r"times: one number or one axis"):
        path.at([[1.0]])


@pytest.mark.usefixtures("no_type_checks")
def test_what_is_no_number_is_named():
    path = drive()
    with pytest.raises(ValueError, match=r"rate: a positive number.*got '100'"):
        path.sample(rate="100")  # pyright: ignore[reportArgumentType]
    for times in ("a", None, [[1.0], [1.0, 2.0]]):
        with pytest.raises(ValueError, match=r"times: numbers are expected, in s, got"):
            path.at(times)


# --- tables ---


def table(file):
    with open(file, newline="") as stream:
        header, *rows = csv.reader(stream)
    return header, np.array(rows, float)


def test_a_table_is_read_back_bitwise(swing, tmp_path):
    samples = swing.sample(rate=3.0)
    samples.to_csv(tmp_path / "swing.csv")
    header, values = table(tmp_path / "swing.csv")
    assert header == ["time [s]", "x0", "x1", "u0", "u1", "dx0/dt", "dx1/dt"]
    expected = [samples.time[:, None], samples.state, samples.control, samples.state_rate]
    np.testing.assert_array_equal(values, np.concatenate(expected, axis=1))
    np.testing.assert_array_equal(np.loadtxt(tmp_path / "swing.csv", delimiter=",", skiprows=1), values)


def test_a_table_takes_names(swing, tmp_path):
    samples = swing.at([0.1])
    samples.to_csv(
        tmp_path / "swing.csv", states=("angle [rad]", "rate [rad/s]"), controls=("held", "linear")
    )
    header, values = table(tmp_path / "swing.csv")
    assert header[1:5] == ["angle [rad]", "rate [rad/s]", "held", "linear"]
    assert values.shape == (1, 7)
    with pytest.raises(ValueError, match="states: 2 names are needed, got 1"):
        samples.to_csv(tmp_path / "swing.csv", states=("angle",))


def test_a_table_of_a_flight_has_units_and_accelerations(flight, tmp_path):
    samples = flight.at(flight.time[:-1])
    samples.to_csv(tmp_path / "flight.csv")
    header, values = table(tmp_path / "flight.csv")
    columns = dict(zip(header, values.T, strict=True))
    np.testing.assert_array_equal(columns["time [s]"], samples.time)
    np.testing.assert_array_equal(columns["z [m]"], samples.position[:, 2])
    np.testing.assert_array_equal(columns["az [m/s^2]"], samples.acceleration[:, 2])
    np.testing.assert_array_equal(columns["thrust 4 [N]"], samples.control[:, 3])
    assert len(header) == 1 + 13 + 4 + 6


def test_a_table_of_a_batch_is_refused(swing, tmp_path):
    samples = swing.at([0.1, 0.2])
    batch = jax.tree.map(lambda v: jnp.stack([v, v]), samples)
    with pytest.raises(ValueError, match="a table holds one trajectory"):
        batch.to_csv(tmp_path / "batch.csv")
