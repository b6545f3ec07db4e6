"""Every number of a scenario with all its parts, made wrong: the error names the part, and nothing else is raised."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp.corridor import box, connect, obstacles_near

WRONG = (np.nan, np.inf, -np.inf, 0.0, -1.0, 1e300, 1e-300)


def whole():
    """A scenario in which no part is None."""
    corridor = connect([box([0, -1, 0], [6, 1, 2]), box([4, -1, 0], [9, 1, 2])], margin=0.1)
    return jaxscp.scenarios.through(
        corridor,
        jaxscp.at_rest([1.0, 0.0, 1.0]),
        jaxscp.at_rest([8.0, 0.0, 1.0]),
        near_obstacles=obstacles_near(corridor, [[3.0, 1.2, 1.0]], 0.3),
        limits=jaxscp.flight_limits(speed=3.0, tilt=0.5, body_rate=9.0, thrust_rate=50.0),
        gates=jaxscp.ellipsoids([[3.0, 0.0, 1.0]], 0.3),
        keep_out=jaxscp.ellipsoids([[6.0, 0.9, 1.0]], 0.3),
        deck_velocity=[0.0, 0.0, 0.0],
        start_fixed=jaxscp.fixed(),
        goal_fixed=jaxscp.fixed(),
    )


PATHS = [jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_leaves_with_path(whole())]


def mutations(leaf):
    """The leaf in wrong shapes, and with a wrong number."""
    yield from (jnp.concatenate([jnp.ravel(leaf)] * 2), jnp.ravel(leaf)[:0], leaf[None])
    for value in WRONG if leaf.dtype != bool else ():
        wrong = np.array(leaf)
        wrong.reshape(-1)[0] = value
        yield jnp.asarray(wrong)


# overflow of absurd numbers in a rule is no warning for the user, who gets the rule's error
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_an_error_names_the_part_that_is_wrong():
    leaves, tree = jax.tree.flatten(whole())
    jaxscp.validate(whole(), nodes=30)
    for row, path in enumerate(PATHS):
        for wrong in mutations(leaves[row]):
            try:
                mutated = jax.tree.unflatten(tree, [*leaves[:row], wrong, *leaves[row + 1 :]])
                jaxscp.validate(mutated, nodes=30)
            except (jaxscp.InvalidScenario, UserWarning) as error:  # a doubt names the part, too
                assert path.lstrip(".").split(".")[0] in str(error)  # noqa: PT017
            else:
                assert wrong.shape == leaves[row].shape, path
