"""The guess of a re-plan: the old plan, moved so that it meets the new start and goal.

Position, velocity and body rate are shifted, and attitudes turned, by amounts that change linearly from the start's to
the goal's. Else the first subproblems would have to turn every node at once after a large change of a heading.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.core.types import Quaternion
from jaxscp.dynamics import rotations
from jaxscp.landing.mission import BodyState, Components, Mission
from jaxscp.problem.trajectory import Trajectory


def warm_guess(mission: Mission, plan: Trajectory) -> Trajectory:
    """The plan with its ends on the mission's boundary; components that are free there stay."""
    mission = mission.with_unit_directions()
    goal = mission.goal_at(plan.time[-1])
    ends = [
        _correction(plan.state[0], mission.start, mission.start_fixed),
        _correction(plan.state[-1], goal, mission.goal_fixed),
    ]
    (first, first_turn), (last, last_turn) = ends
    fraction = jnp.linspace(0.0, 1.0, plan.nodes)[:, None]
    state = plan.state + (1.0 - fraction) * first + fraction * last
    turns = rotations.blend(first_turn, last_turn, plan.nodes)
    attitude = jax.vmap(lambda turn, q: rotations.normalised(rotations.multiply(turn, q)))(
        turns, plan.state[:, 6:10]
    )
    return Trajectory(plan.time, state.at[:, 6:10].set(attitude), plan.control, plan.dilation)


def _correction(
    state: Float[Array, "13"], target_state: BodyState, fixed: Components | None
) -> tuple[Float[Array, "13"], Quaternion]:
    """Shift of the state, zero for the attitude, and the rotation in the world that turns it."""
    target = target_state.vector()
    turn = rotations.multiply(target[6:10], rotations.conjugate(state[6:10]))
    turn = jnp.where(turn[0] < 0.0, -turn, turn)
    shift = (target - state).at[6:10].set(0.0)
    if fixed is None:
        return shift, turn
    mask = fixed.vector()
    shift = shift.at[:6].multiply(mask[:6]).at[10:].multiply(mask[9:])
    return shift, jnp.where(jnp.all(mask[6:9] > 0.0), turn, jnp.eye(4, dtype=turn.dtype)[0])
