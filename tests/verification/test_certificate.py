"""The certificate of a trajectory that cannot be integrated."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp as js
from jaxscp import Planner, scenarios
from jaxscp.transcription.layout import trajectory_of
from jaxscp.verification.certificate import _in_one_unit, certify

TUMBLING = 1e6  # N of one rotor: far more turns an interval than steps of the integration


def test_rows_with_tolerances_of_their_own_are_compared_by_these():
    """Of 1 N and 0.01 rad, the angle is the worse; it passes or fails in its own unit."""
    tolerances = jnp.array([20.0, 2e-4])
    found = _in_one_unit(jnp.array([5.0, 0.0]), jnp.array([1.0, 0.01]), tolerances)
    np.testing.assert_allclose(found, [5e-5, 0.01, 2e-4], rtol=1e-12)
    one = _in_one_unit(jnp.array([5.0, 0.0]), jnp.array([1.0, 0.01]), jnp.asarray(20.0))
    np.testing.assert_array_equal(one, [5.0, 1.0, 20.0])


def test_a_trajectory_of_another_problem_is_refused():
    model = js.Dynamics.of(lambda x, u, t, p: jnp.stack([x[1], u[0]]), states=2, controls=1)
    ends = js.Boundary(js.fixed_state([0.0, 0.0]), js.fixed_state([1.0, 0.0]))
    problem = js.OptimalControlProblem(
        model, js.Cost(), ends, js.Time(nodes=3, final=js.FixedTime(1.0)), zero_order_hold=(0,)
    )
    plan = js.Trajectory.from_arrays([0.0, 0.5, 1.0], np.zeros((3, 2)), np.zeros((3, 1)))
    with pytest.raises(
        js.InvalidProblem, match=r"trajectory\.zero_order_hold: \(\), but the problem's is \(0,\)"
    ):
        certify(problem, plan)
    plan = js.Trajectory.from_arrays([0.0, 0.5, 1.0], np.zeros((3, 2)), np.zeros((3, 2)))
    with pytest.raises(js.InvalidProblem, match=r"trajectory\.control: 2 components, but dynamics has 1"):
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
