"""Messages of rules: a start outside of its polytope names the face that it is beyond."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp.corridor import Corridor, box, connect
from jaxscp.landing.rule import face_text


def test_a_start_above_the_ceiling_names_the_face():
    goal = jaxscp.at_rest([8.0, 2.0, 1.0])
    room = connect([box([0, 0, 0], [9, 4, 2.4])], margin=0.35)
    for position, words in (
        ([1.0, 2.0, 2.2], r"0\.15 m outside .* first polytope, above its face z <= 2\.05 m; margin=0\.35 m"),
        ([1.0, 2.0, 0.3], r"0\.05 m outside .*, below its face z >= 0\.35 m"),
        ([0.25, 2.0, 1.0], r"0\.1 m outside .*, beyond its face x >= 0\.35 m"),
    ):
        with pytest.raises(jaxscp.InvalidScenario, match=r"start\.position: lies " + words):
            jaxscp.validate(jaxscp.scenarios.through(room, jaxscp.at_rest(position), goal))


def test_a_face_that_is_askew_is_named_by_its_normal():
    corridor = Corridor(jnp.array([[[0.6, 0.0, 0.8]]]), jnp.array([[1.0]]), jnp.empty((0, 3)))
    words = face_text(corridor, 0, np.array([1.0, 0.0, 1.0]))
    assert words == "beyond its face with the normal (0.6, 0, 0.8)"
