"""Places that are no three numbers: the message names them."""

import jax
import jax.numpy as jnp
import pytest

import jaxscp
from jaxscp.corridor import box


@pytest.mark.parametrize("value", [None, "abc", [0.0, 1.0], 1.0, [["a", "b", "c"]]])
def test_what_is_no_position_is_named(value):
    with pytest.raises(ValueError, match=r"^position: expected three numbers, got"):
        jaxscp.at_rest(value)


@pytest.mark.parametrize("value", ["abc", [0.0, 1.0], [["a", "b", "c"]]])
def test_what_is_no_corner_is_named(value):
    with pytest.raises(ValueError, match=r"^box: upper: expected three numbers, got"):
        box([0.0, 0.0, 0.0], value)


def test_places_may_be_traced():
    rooms = jax.vmap(box, in_axes=(None, 0))([0.0, 0.0, 0.0], jnp.ones((2, 3)))
    states = jax.jit(jax.vmap(jaxscp.at_rest))(jnp.ones((2, 3)))
    assert rooms.offsets.shape == (2, 6)
    assert states.position.shape == (2, 3)
