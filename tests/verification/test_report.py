"""A certificate as text, and what passes, for batches."""

import jax
import jax.numpy as jnp

from jaxscp.verification.certificate import Certificate

ALLOWED = 1e-3


def one(end, violation, optimality=None):
    """With one row at an end and one constraint."""
    ends, violations = jnp.asarray(end)[None], jnp.asarray(violation)[None]
    return Certificate(
        defect=ends[0],
        end_errors=ends,
        end_tolerances=jnp.full(1, ALLOWED),
        at_nodes=0.5 * violations,
        between_nodes=violations,
        allowed=jnp.full(1, ALLOWED),
        optimality=optimality,
        names=("speed",),
        end_names=("final position",),
        end_units=("m",),
    )


def certificate(*arrays):
    """Of a batch."""
    return jax.vmap(one)(*map(jnp.asarray, arrays))


def test_each_element_passes_by_its_own_values():
    batch = certificate([0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], jnp.array([0.0, 0.0, 0.0, 1.0]))
    assert batch.passed().tolist() == [True, False, False, False]
    assert batch.passed(between_nodes=False).tolist() == [True, False, True, False]
    assert one(0.0, 0.0).passed().shape == ()


def test_a_row_of_a_batch_has_the_worst_element():
    text = certificate([0.0, 0.25, jnp.nan, 0.0], [0.0, 0.0, jnp.nan, 0.5]).report()
    assert text.splitlines() == [
        "1 of 4 pass; each row has the worst element's value; 1 invalid",
        "final position  off by 0.25 m (element 1)",
        "speed           violated by 0.25 at nodes, 0.5 between (element 3)",
        "largest defect 0.25 (element 1)",
    ]


def test_elements_of_a_grid_have_an_index_for_each_axis():
    batch = jax.vmap(certificate)(jnp.arange(6.0).reshape(2, 3), jnp.zeros((2, 3)))
    assert "off by 5 m (element 1, 2)" in batch.report()


def test_a_batch_of_invalid_elements_says_so():
    assert "2 invalid" in certificate([jnp.nan, jnp.nan], [jnp.nan, jnp.nan]).report()
    assert "off by nan m" in certificate([jnp.nan, jnp.nan], [jnp.nan, jnp.nan]).report()


def test_an_infinite_error_is_the_worst():
    assert "off by inf m (element 1)" in certificate([0.5, jnp.inf], [0.0, 0.0]).report()
