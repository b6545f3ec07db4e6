"""Rollouts by the GPU kernel, run on a CPU by one thread, compared with rollouts by diffrax."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp.backends import launch
from jaxscp.dynamics.base import Dynamics
from jaxscp.verification.integrator import cuda_source, in_cuda, in_jax
from jaxscp.verification.integrator.integrate import integrate
from tests.support.kernels import as_on_a_gpu, compiled, handler, needs_compiler, needs_nvidia

NODES, SAMPLES = 4, 7
AGREEMENT = 1e-8  # of two rollouts whose steps have errors of 1e-10 each
BODY = jaxscp.airframes.paper_mav().body


class Extreme(Dynamics):
    """A state x that decays with the control, and a state y that diverges in time 1 / (power y)."""

    power: jax.Array
    state_size = 2
    control_size = 1

    def __call__(self, state, control, time):
        x, y = state
        return jnp.stack([-(control[0] ** 2) * x, self.power * y * y])


class Many(Dynamics):
    """A ring of states, each driven by the next."""

    state_size = cuda_source.WARP + 3
    control_size = 1

    def __call__(self, state, control, time):
        return control[0] * jnp.sin(jnp.concatenate([state[1:], state[:1]]) - state)


def flights(count):
    """Initial states, controls and dilations of distinct rigid-body trajectories."""
    keys = jax.random.split(jax.random.key(0), 3)
    start = jnp.zeros((count, 13)).at[:, 6].set(1.0) + 0.1 * jax.random.normal(keys[0], (count, 13))
    control = BODY.hover_thrust() * (1.0 + 0.1 * jax.random.normal(keys[1], (count, NODES, 4)))
    dilation = 1.0 + jax.random.uniform(keys[2], (count, NODES))
    return start, control, dilation


def by_diffrax(dynamics, start, control, dilation, samples=SAMPLES):
    """States of controls that are linear between the nodes."""
    return in_jax.states(dynamics, start, (control[:-1], control[1:]), dilation, samples)


def integrated_by(group_size, tmp_path):
    """A function: states by the kernel; ``group_size`` threads integrate one trajectory."""
    words = {1: "threads_on_a_cpu.h", cuda_source.WARP: "warps_on_a_cpu.h"}

    def states(dynamics, start, control, dilation, samples=SAMPLES):
        slope = in_cuda.record(dynamics)
        code = compiled(
            cuda_source.kernel(slope, dilation.shape[0] - 1, samples), tmp_path, words[group_size]
        )
        target, threads = in_cuda.LIBRARY.on_gpu, cuda_source.BLOCK_THREADS
        kernel = in_cuda.Kernel(dynamics, slope, launch.Kernel(target, code, group_size, threads), samples)
        return kernel(start, control, dilation)

    return states


@pytest.fixture
def emulated(tmp_path, monkeypatch):
    """The kernel with one thread a trajectory."""
    monkeypatch.setattr(in_cuda, "LIBRARY", in_cuda.LIBRARY._replace(on_gpu=handler()))
    return integrated_by(1, tmp_path)


@pytest.mark.slow
@needs_compiler
def test_a_warp_integrates_one_trajectory(tmp_path, monkeypatch):
    """More states and samples than threads a trajectory, and more trajectories than a block has."""
    monkeypatch.setattr(in_cuda, "LIBRARY", in_cuda.LIBRARY._replace(on_gpu=handler()))
    count, size, samples = (
        1 + cuda_source.BLOCK_THREADS // cuda_source.WARP,
        Many.state_size,
        2 * cuda_source.WARP + 5,
    )
    start = jax.random.normal(jax.random.key(1), (count, size))
    given = start, jnp.ones((count, 3, 1)), jnp.full((count, 3), 1.5)

    def by(states):
        return jax.jit(jax.vmap(lambda *one: states(Many(), *one, samples)))(*given)

    found = by(integrated_by(cuda_source.WARP, tmp_path))
    np.testing.assert_allclose(found, by(by_diffrax), rtol=0, atol=AGREEMENT)


@pytest.mark.slow
@needs_compiler
def test_it_is_the_rollout_by_diffrax(emulated):
    """A batch with different masses."""
    bodies = lambda mass: dataclasses.replace(BODY, mass=mass)  # noqa: E731
    given = jnp.array([0.9, 1.0, 1.3]) * BODY.mass, *flights(3)

    def by(states):
        return jax.jit(jax.vmap(lambda mass, *rest: states(bodies(mass), *rest, SAMPLES)))(*given)

    expected, found = by(by_diffrax), by(emulated)
    assert found.shape == (3, NODES - 1, SAMPLES, 13)
    np.testing.assert_allclose(found, expected, rtol=0, atol=AGREEMENT)


@needs_compiler
def test_closed_form(emulated):
    """x' = -u^2 x with u linear in time."""
    start, control = jnp.array([1.0, 0.0]), jnp.array([[0.5], [2.0], [1.0], [0.0]])
    found = emulated(Extreme(jnp.zeros(())), start, control, jnp.full(NODES, 3.0))
    fraction = np.linspace(0.0, 1.0, SAMPLES)
    logarithm, last = np.zeros((NODES - 1, SAMPLES)), 0.0
    for k, (a, b) in enumerate(zip(control[:-1, 0], control[1:, 0], strict=True)):
        logarithm[k] = last + a**2 * fraction + a * (b - a) * fraction**2 + (b - a) ** 2 * fraction**3 / 3.0
        last = logarithm[k, -1]
    np.testing.assert_allclose(found[:, :, 0], np.exp(-logarithm), rtol=0, atol=AGREEMENT)


class Sudden(Dynamics):
    """A state that decays fast; the derivative is undefined below -1, where a step too long leads."""

    state_size = 1
    control_size = 1

    def __call__(self, state, control, time):
        return -control[0] * state * jnp.sqrt(1.0 + state)


@needs_compiler
def test_a_step_that_leads_nowhere_is_shortened(emulated):
    given = jnp.ones(1), jnp.full((NODES, 1), 300.0), jnp.full(NODES, 1.0)
    expected, found = by_diffrax(Sudden(), *given), emulated(Sudden(), *given)
    assert np.isfinite(expected).all()
    np.testing.assert_allclose(found, expected, rtol=0, atol=AGREEMENT)


@needs_compiler
def test_a_failed_integration_is_infinite_and_other_elements_are_not(emulated):
    powers = jnp.array([0.1, 2.0, jnp.nan])
    start, control, dilation = jnp.array([1.0, 1.0]), jnp.ones((NODES, 1)), jnp.full(NODES, 1.0)
    by = lambda states: jax.vmap(lambda p: states(Extreme(p), start, control, dilation, SAMPLES))(powers)  # noqa: E731
    expected, found = by(by_diffrax), by(emulated)
    np.testing.assert_allclose(found[0], expected[0], rtol=0, atol=AGREEMENT)
    np.testing.assert_array_equal(np.isinf(found[1:]), np.isinf(expected[1:]))
    assert np.isinf(found[1:]).all(axis=(2, 3)).tolist() == [[False, True, True], [True, True, True]]


@pytest.mark.slow
@needs_compiler
def test_a_kernel_of_other_dynamics_integrates_nothing(emulated, monkeypatch):
    """The rollout ends at the first interval whose initial state derivative differs from the dynamics.

    Later intervals are lost even where the derivatives agree: without thrust the mass has no effect.
    """
    other = dataclasses.replace(BODY, mass=1.001 * BODY.mass)
    start, control, dilation = (v[0] for v in flights(1))
    control = control.at[np.array([0, 2])].set(0.0)
    record = in_cuda.record
    monkeypatch.setattr(in_cuda, "record", lambda _: record(other))
    found = emulated(BODY, start, control, dilation)
    assert np.isfinite(found).all(axis=(1, 2)).tolist() == [True, False, False]


@needs_nvidia
@pytest.mark.parametrize("capability", ["80", "90"])
def test_kernel_compiles(capability):
    text = cuda_source.kernel(in_cuda.record(BODY), NODES - 1, SAMPLES)
    assert launch.cubin(text, capability, "the flight").startswith(b"\x7fELF")


def test_an_interval_has_two_samples_at_least():
    start, control, dilation = (v[0] for v in flights(1))
    trajectory = jaxscp.Trajectory(dilation, jnp.tile(start, (NODES, 1)), control, dilation)
    with pytest.raises(ValueError, match="samples: 1 of an interval"):
        integrate(BODY, trajectory, 1)


class Untraceable(Dynamics):
    state_size = 2
    control_size = 1

    def __call__(self, state, control, time):
        return jnp.sort(state) * control


def test_a_gpu_runs_the_kernel_where_there_is_one(monkeypatch):
    """As on a machine with a GPU: each device has its own integrator."""
    start, control, dilation = (v[0] for v in flights(1))
    assert in_cuda.kernel_for(BODY, start, control, SAMPLES) is None
    as_on_a_gpu(monkeypatch)

    def calls(platform, dynamics, start, control):
        states = jnp.zeros((NODES, dynamics.state_size)).at[0].set(start)
        trajectory = jaxscp.Trajectory(dilation, states, control, dilation)
        traced = jax.jit(functools.partial(integrate, dynamics, samples=SAMPLES)).trace(trajectory)
        return in_cuda.LIBRARY.on_gpu in traced.lower(lowering_platforms=(platform,)).as_text()

    assert calls("cuda", BODY, start, control)
    assert not calls("cpu", BODY, start, control)
    assert not calls("cuda", Untraceable(), jnp.ones(2), jnp.ones((NODES, 1)))
    assert in_cuda.kernel_for(BODY, start.astype(jnp.float32), control, SAMPLES) is None
