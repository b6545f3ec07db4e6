"""Integration by diffrax's Dopri8, interval after interval."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.dynamics.base import Dynamics
from jaxscp.verification.integrator.accuracy import FIRST_STEP, TOLERANCE, most_steps


def states(
    dynamics: Dynamics,
    start: Float[Array, "n"],
    controls: tuple[Float[Array, "intervals m"], Float[Array, "intervals m"]],
    dilation: Float[Array, "nodes"],
    samples: int,
) -> Float[Array, "intervals samples n"]:
    """States at points of every interval; infinite where the integration fails.

    Args:
        dynamics: to integrate; time is zero.
        start: first state.
        controls: at the first and at the last point of every interval; linear between.
        dilation: at the nodes.
        samples: points an interval.
    """
    # Imported here: diffrax is slow to import, and a planner from a cache does not need it.
    from diffrax import Dopri8, ODETerm, PIDController, SaveAt, diffeqsolve, is_successful

    intervals = dilation.shape[0] - 1
    width = 1.0 / intervals
    fractions = jnp.linspace(0.0, 1.0, samples)

    def rate(fraction, state, ends):
        (u0, u1), (s0, s1) = ends
        return width * (s0 + fraction * (s1 - s0)) * dynamics(state, u0 + fraction * (u1 - u0), 0.0)

    def interval(state, ends):
        solution = diffeqsolve(
            ODETerm(rate),
            Dopri8(scan_kind="lax"),
            0.0,
            1.0,
            FIRST_STEP,
            state,
            args=ends,
            # Not SaveAt(ts=...): its check of the times is a call back into Python, which no file can store.
            saveat=SaveAt(dense=True),
            stepsize_controller=PIDController(rtol=TOLERANCE, atol=TOLERANCE),
            max_steps=most_steps(intervals),
            throw=False,
        )
        sampled = jax.vmap(lambda fraction: jnp.asarray(solution.evaluate(fraction)))(fractions)
        states = jnp.where(is_successful(solution.result), sampled, jnp.inf)
        return states[-1], states

    _, found = jax.lax.scan(interval, start, (controls, (dilation[:-1], dilation[1:])))
    return found
