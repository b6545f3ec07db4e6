"""Convexified Hessian: always convex, and the same quadratic where the linearised dynamics hold."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.scp.hessian_convexification import LinearDynamics, convexified_along_horizon, projected

INTERVALS, STATES, CONTROLS = 7, 3, 2
STAGE, INPUTS = STATES + CONTROLS, STATES + 2 * CONTROLS
ROUNDING = 1e-9


def random_chain(seed):
    random = np.random.default_rng(seed)
    jacobian = 0.5 * random.standard_normal((INTERVALS, STATES, INPUTS))
    return LinearDynamics(jnp.asarray(jacobian), jnp.asarray(random.standard_normal((INTERVALS, STATES))))


def feasible(chain, seed):
    """Variables of the intervals that obey the linear dynamics from a zero state, and the last stage."""
    random = np.random.default_rng(seed)
    controls = random.standard_normal((INTERVALS + 1, CONTROLS))
    state, stages = np.zeros(STATES), []
    for i in range(INTERVALS):
        w = np.concatenate([state, controls[i], controls[i + 1]])
        stages.append(w)
        state = np.asarray(chain.jacobian[i]) @ w + np.asarray(chain.defect[i])
    return jnp.asarray(np.array(stages)), jnp.asarray(np.concatenate([state, controls[-1]]))


def quadratic(hessian, w):
    return float(0.5 * jnp.einsum("iw,iwv,iv->", w, hessian, w))


def random_hessian(seed, shift=0.0):
    random = np.random.default_rng(seed)
    h = random.standard_normal((INTERVALS, INPUTS, INPUTS))
    return jnp.asarray(0.5 * (h + h.transpose(0, 2, 1)) + shift * np.eye(INPUTS))


def eigenvalues(hessian):
    return np.linalg.eigvalsh(np.asarray(hessian))


@pytest.mark.parametrize("seed", range(5))
def test_blocks_are_convex_however_curved_the_problem(seed):
    hessian, chain = random_hessian(seed), random_chain(seed)
    for convex in (projected(hessian), convexified_along_horizon(hessian, chain, jnp.zeros((STAGE, STAGE)))):
        assert eigenvalues(convex.hessian).min() > -ROUNDING
        assert bool(convex.clipped.any())


def test_projection_keeps_what_is_convex():
    hessian = random_hessian(0, shift=10.0)
    convex = projected(hessian)
    np.testing.assert_allclose(convex.hessian, hessian, atol=ROUNDING)
    assert not bool(convex.clipped.any())


@pytest.mark.parametrize("seed", range(5))
def test_condensing_changes_nothing_where_the_dynamics_hold(seed):
    """Blocks that are not convex, in a convex problem: negative curvature in states, positive in controls."""
    down = jnp.diag(jnp.concatenate([-0.05 * jnp.ones(STATES), jnp.ones(CONTROLS), 2.0 * jnp.ones(CONTROLS)]))
    hessian = jnp.broadcast_to(down, (INTERVALS, INPUTS, INPUTS)) + 0.05 * random_hessian(seed)
    chain, final = random_chain(seed), jnp.eye(STAGE)
    convex = convexified_along_horizon(hessian, chain, final)
    assert eigenvalues(hessian).min() < 0.0
    assert eigenvalues(convex.hessian).min() > -ROUNDING
    assert not bool(convex.clipped.any())
    differences = []
    for flight in range(4):
        w, last = feasible(chain, flight)
        given = quadratic(hessian, w) + 0.5 * float(last @ final @ last)
        changed = quadratic(convex.hessian, w) + float(jnp.vdot(convex.gradient, w))
        differences.append(given - changed)
    np.testing.assert_allclose(differences, differences[0], atol=1e-8)  # a constant, from the defects
