"""The status by the certificate: it refutes a claim to have converged, and one to have found no flight."""

import jax.numpy as jnp
import pytest

from jaxscp.core.status import Status, status_names
from jaxscp.solver.conclude import _status
from jaxscp.verification.certificate import OPTIMALITY_TOLERANCE, Certificate


def certificate(end=0.0, constraint=0.0, optimality=0.0, clearance=0.1):
    """Of one end and one constraint, with tolerances of one."""
    numbers = [jnp.asarray(v) for v in (0.0, [end], [1.0], [constraint], [constraint], [1.0], optimality)]
    return Certificate(*numbers, ("corridor",), ("final position",), ("m",), jnp.asarray(clearance))


GOOD, SHORT = {}, {"optimality": 2.0 * OPTIMALITY_TOLERANCE}
OFF, OUTSIDE, HIT = {"end": 2.0}, {"constraint": 2.0}, {"clearance": -0.1}


@pytest.mark.parametrize(
    ("claimed", "found", "expected"),
    [
        ("converged", GOOD, "converged"),
        ("converged", SHORT, "verification_failed"),
        ("converged", OFF, "verification_failed"),
        ("converged", OUTSIDE, "verification_failed"),
        ("converged", HIT, "verification_failed"),
        ("dynamics_unmet", OFF, "dynamics_unmet"),
        ("dynamics_unmet", OUTSIDE, "dynamics_unmet"),
        ("dynamics_unmet", HIT, "dynamics_unmet"),
        ("dynamics_unmet", GOOD, "insufficient_progress"),
        ("dynamics_unmet", SHORT, "insufficient_progress"),
        ("constraints_unmet", SHORT, "insufficient_progress"),
        ("iteration_limit", GOOD, "iteration_limit"),
        ("infeasible", GOOD, "infeasible"),
    ],
)
def test_the_certificate_has_the_last_word(claimed, found, expected):
    assert status_names(_status(getattr(Status, claimed), certificate(**found), True)) == expected


def test_a_method_that_claims_nothing_between_nodes_is_not_refuted_there():
    found = certificate(**OUTSIDE)
    assert status_names(_status(Status.converged, found, False)) == "converged"
    assert status_names(_status(Status.dynamics_unmet, found, False)) == "dynamics_unmet"
