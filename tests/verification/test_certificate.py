"""The certificate of a trajectory that cannot be integrated."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp import Planner, scenarios
from jaxscp.transcription.layout import trajectory_of
from jaxscp.verification.certificate import certify

TUMBLING = 1e6  # N of one rotor: far more turns an interval than steps of the integration


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
