"""Certificates: rows of different size, trajectories of another problem, and those that cannot be integrated."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp as js
from jaxscp import Planner, scenarios
from jaxscp.transcription.layout import trajectory_of
from jaxscp.verification.certificate import certify
from jaxscp.verification.violations import _in_one_unit

TUMBLING = 1e6  # N of one rotor: far more turns an interval than steps of the integration


def test_rows_with_tolerances_of_their_own_are_compared_by_these():
    """Of 1 N and 0.01 rad, the angle is the worse; it passes or fails in its own unit."""
    tolerances = jnp.array([20.0, 2e-4])
    found = _in_one_unit(jnp.array([5.0, 0.0]), jnp.array([1.0, 0.01]), tolerances)
    np.testing.assert_allclose(found, [5e-5, 0.01, 2e-4], rtol=1e-12)
    one = _in_one_unit(jnp.array([5.0, 0.0]), jnp.array([1.0, 0.01]), jnp.asarray(20.0))
    np.testing.assert_array_equal(one, [5.0, 1.0, 20.0])


def request(final, hold=()):
    model = js.Dynamics.of(lambda x, u, t, p: jnp.stack([x[1], u[0]]), states=2, controls=1)
    ends = js.Boundary(js.fixed_state([0.0, 0.0]), js.fixed_state([1.0, 0.0]))
    return js.OptimalControlProblem(
        model, js.Cost(), ends, js.Time(nodes=3, final=final), zero_order_hold=hold
    )


def trajectory(controls=1):
    return js.Trajectory.from_arrays([0.0, 1.0, 2.0], np.zeros((3, 2)), np.zeros((3, controls)))


@pytest.mark.parametrize(
    ("problem", "plan", "words"),
    [
        (
            request(js.FixedTime(2.0), (0,)),
            trajectory(),
            r"zero_order_hold: \(\), but the problem's is \(0,\)",
        ),
        (request(js.FixedTime(2.0)), trajectory(2), "control: 2 components, but dynamics has 1"),
        (request(js.FixedTime(1.0)), trajectory(), "lasts 2 s, but the problem's final time is 1 s"),
        (request(js.FreeTime(0.1, 0.5)), trajectory(), "final time is within 0.1 and 0.5 s"),
        (request(js.FreeTime(5.0, 9.0)), trajectory(), "final time is within 5 and 9 s"),
        (
            request(js.FreeTime(0.5, 3.0)),
            eqx.tree_at(lambda t: t.time, trajectory(), 0.5 * trajectory().time),
            "lasts 1 s, but its dilation lasts 2 s",
        ),
    ],
)
def test_a_trajectory_of_another_problem_is_refused(problem, plan, words):
    with pytest.raises(js.InvalidProblem, match=words):
        certify(problem, plan)


@pytest.mark.nightly
def test_a_flight_that_cannot_be_integrated_is_infinitely_bad():
    problem, z, _ = Planner(nodes=10).pipeline.setup(scenarios.ascent_to_platform())
    trajectory = trajectory_of(problem, z.at[:, problem.state_size].add(TUMBLING))
    certificate = jax.jit(certify, static_argnums=2)(problem, trajectory, 10)
    assert not bool(certificate.passed())
    assert np.isinf(certificate.error("final position"))
    assert np.isinf(certificate.violation)
    for leaf in jax.tree.leaves(certificate):
        assert not bool(jnp.any(jnp.isnan(leaf)))
