"""The mission as an optimal control problem: leave a deck, fly a corridor, land in a cone (equations 20-24)."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxscp import rotations
from jaxscp.airframes import Airframe
from jaxscp.constraints import (
    Constraint,
    HalfSpaces,
    LandingCone,
    Limits,
    NonNegative,
    SecondOrder,
    inside_half_spaces,
    inside_landing_cone,
    repeat_over_nodes,
    within_control_limits,
)
from jaxscp.corridor.polytopes import Corridor
from jaxscp.problem import Boundary, FixedComponents, OptimalControlProblem, fixed_components
from jaxscp.types import Points, Quaternion, Scalar, Vector3

CONE_NODES = 6  # the last six nodes lie in the landing cone, as in the paper


class BodyState(eqx.Module):
    """Position, velocity, attitude and body rate of a vehicle."""

    position: Vector3
    """m, world."""
    velocity: Vector3
    """m/s, world."""
    attitude: Quaternion
    """(w, x, y, z), body to world, unit norm."""
    body_rate: Vector3
    """rad/s, body."""

    def vector(self) -> Float[Array, "13"]:
        """The 13 states in order."""
        return jnp.concatenate([self.position, self.velocity, self.attitude, self.body_rate])


def at_rest(position, yaw: float = 0.0) -> BodyState:
    """Level and at rest at a position in m, heading ``yaw`` radians.

    Example:
        >>> import jaxscp
        >>> jaxscp.at_rest([1.0, 2.0, 3.0]).vector().shape
        (13,)
    """
    zero = jnp.zeros(3)
    return BodyState(jnp.asarray(position, float), zero, rotations.from_yaw(yaw), zero)


class Weights(eqx.Module):
    """Weights of the cost: control effort w_u and flight time w_t (equation 8, Table I)."""

    control: Scalar
    time: Scalar


class LandingScenario(eqx.Module):
    """Everything that a Monte Carlo study may vary, as one pytree; every float is a leaf.

    Example:
        >>> import jaxscp
        >>> scenario = jaxscp.scenarios.platform_to_platform()
        >>> scenario.corridor.count
        5
    """

    airframe: Airframe
    start: BodyState
    goal: BodyState
    corridor: Corridor
    cone_angle: Scalar
    """gamma_c in radians: angle of the landing cone's side above the deck; pi/4 in the paper."""
    weights: Weights
    dilation_min: Scalar
    """Least dt/dtau in s: bounds the flight time and every part of the mesh."""
    dilation_max: Scalar
    """Greatest dt/dtau in s."""
    obstacles: Points | None = None
    """Point cloud in m that the corridor avoids, for pictures and for checks; the solver does not read it."""


def allocate(corridor: Corridor, start: Vector3, goal: Vector3, nodes: int) -> Int[Array, "intervals"]:
    """Polytope of every interval: shares by the length of the route start, joints, goal; at least one each.

    The time dilation adapts the mesh afterwards (Remark 1 of the paper).
    """
    route = jnp.concatenate([start[None], corridor.joints, goal[None]])
    length = jnp.cumsum(jnp.linalg.norm(jnp.diff(route, axis=0), axis=1))
    spare = nodes - 1 - corridor.count
    share = length[:-1] / jnp.maximum(length[-1], 1e-9)
    ends = jnp.arange(1, corridor.count) + jnp.round(spare * share).astype(int)
    return jnp.searchsorted(ends, jnp.arange(nodes - 1), side="right").astype(int)


def route_positions(
    corridor: Corridor, start: Vector3, goal: Vector3, allocation: Int[Array, "intervals"]
) -> Points:
    """Positions of the nodes on the polyline start, joints, goal; the nodes of a polytope evenly spaced on it."""
    route = jnp.concatenate([start[None], corridor.joints, goal[None]])
    intervals = jnp.arange(allocation.shape[0])
    first = jnp.searchsorted(allocation, allocation, side="left").astype(int)
    last = jnp.searchsorted(allocation, allocation, side="right").astype(int)
    share = (intervals - first) / (last - first)
    points = route[allocation] + share[:, None] * (route[allocation + 1] - route[allocation])
    return jnp.concatenate([points, goal[None]])


def effort(state, control, weights: Weights) -> Scalar:
    """w_u |u|: Euclidean norm of the rotor thrusts (equation 8)."""
    return weights.control * jnp.sqrt(jnp.sum(control * control))


def flight_time(state, time, weights: Weights) -> Scalar:
    """w_t (t_f - t_0) (equation 8)."""
    return weights.time * time


def in_cone(nodes: int) -> Bool[Array, "nodes"]:
    """The nodes held in the landing cone: the last six, less the very last, which the goal fixes at the apex."""
    index = jnp.arange(nodes)
    return (index >= nodes - CONE_NODES) & (index < nodes - 1)


def same_pose(state, time, goal: Float[Array, "13"]) -> Float[Array, "12"]:
    """Position, velocity, attitude and body rate are the goal's; the attitude by three components."""
    attitude = rotations.attitude_error(state[6:10], goal[6:10])
    return jnp.concatenate([state[:6] - goal[:6], attitude, state[10:] - goal[10:]])


def landing_problem(
    scenario: LandingScenario, allocation: Int[Array, "intervals"], published: bool = False
) -> OptimalControlProblem:
    """The scenario as an optimal control problem on len(allocation) + 1 nodes.

    Args:
        scenario: what to fly.
        allocation: polytope of every interval, see ``allocate``; node k obeys that of interval k.
        published: whether to state it as the paper does: running cost and time are states, and all four components
            of the final quaternion are fixed. The flow keeps |q|, so that one of them is implied by the others and
            multipliers are not unique; otherwise the three components of the attitude's error are zero.
    """
    nodes = allocation.shape[0] + 1
    cell = jnp.concatenate([allocation, allocation[-1:]])
    everywhere = jnp.ones(nodes, bool)
    constraints = (
        Constraint(
            inside_half_spaces,
            HalfSpaces(scenario.corridor.normals[cell], scenario.corridor.offsets[cell]),
            NonNegative(),
            everywhere,
            "corridor",
        ),
        Constraint(
            within_control_limits,
            repeat_over_nodes(Limits(scenario.airframe.thrust_min, scenario.airframe.thrust_max), nodes),
            NonNegative(),
            everywhere,
            "thrust",
            of_controls=True,
        ),
        Constraint(
            inside_landing_cone,
            repeat_over_nodes(LandingCone(scenario.goal.position, 1.0 / jnp.tan(scenario.cone_angle)), nodes),
            SecondOrder(),
            in_cone(nodes),
            "landing cone",
        ),
    )
    everything = jnp.ones(13, scenario.goal.position.dtype)
    start, goal = scenario.start.vector(), scenario.goal.vector()
    # q and -q are one attitude: ask for the one that the start's is nearer to.
    goal = goal.at[6:10].multiply(jnp.where(jnp.dot(start[6:10], goal[6:10]) < 0, -1.0, 1.0))
    return OptimalControlProblem(
        dynamics=scenario.airframe.body,
        running_cost=effort,
        terminal_cost=flight_time,
        weights=scenario.weights,
        constraints=constraints,
        initial=Boundary(fixed_components, FixedComponents(start, everything)),
        final=Boundary(fixed_components, FixedComponents(goal, everything))
        if published
        else Boundary(same_pose, goal),
        dilation_min=scenario.dilation_min,
        dilation_max=scenario.dilation_max,
        nodes=nodes,
        extended=published,
    )
