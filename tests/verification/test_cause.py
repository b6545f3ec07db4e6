"""What holds a plan up: the row of the certificate that is furthest beyond its tolerance."""

import equinox as eqx
import jax.numpy as jnp

from jaxscp.verification.certificate import Certificate

GOOD = Certificate(
    defect=jnp.array(0.0),
    end_errors=jnp.array([0.0, 5e-4]),
    end_tolerances=jnp.array([1e-3, 1e-3]),
    at_nodes=jnp.zeros(2),
    between_nodes=jnp.array([1e-4, 9.0]),
    allowed=jnp.array([1e-3, jnp.inf]),
    optimality=None,
    names=("corridor", "comfort"),
    end_names=("initial position", "final position"),
    end_units=("m", "m"),
)


def test_no_row_is_named_where_all_are_within_their_tolerances():
    assert GOOD.largest_row() == ""


def test_the_row_furthest_beyond_its_tolerance_is_named():
    bad = eqx.tree_at(
        lambda c: (c.end_errors, c.between_nodes), GOOD, (jnp.array([0.0, 2e-3]), jnp.array([0.5, 9.0]))
    )
    assert bad.largest_row() == "corridor, off by 0.5, which is 500 times its tolerance"
    at_ends = bad.largest_row(between_nodes=False)  # the paper's mode holds constraints at the nodes alone
    assert at_ends == "final position, off by 0.002, which is 2 times its tolerance"
    lost = eqx.tree_at(lambda c: c.end_errors, bad, jnp.array([0.0, jnp.inf]))
    assert lost.largest_row().startswith("final position, off by inf")
