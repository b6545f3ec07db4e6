"""The mission as an optimal control problem: leave a deck, fly a corridor, land in a cone (equations 20-24)."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxscp.cones.cone import NonNegative, SecondOrder
from jaxscp.core.types import Scalar
from jaxscp.dynamics import rotations
from jaxscp.landing.allocation import LANDING, gate_nodes, route_positions
from jaxscp.landing.constraints import (
    HalfSpaces,
    LandingCone,
    Limits,
    Zones,
    inside_half_spaces,
    inside_landing_cone,
    inside_zone,
    outside_zones,
    within_body_rate,
    within_control_limits,
    within_speed,
    within_thrust_rate,
    within_tilt,
)
from jaxscp.landing.mission import Mission, Weights
from jaxscp.problem.constraint import (
    DISTANCE_TOLERANCE,
    AcrossIntervals,
    AtNodes,
    Constraint,
    repeat_over_nodes,
)
from jaxscp.problem.form import Continuous, Form
from jaxscp.problem.problem import Boundary, FixedComponents, OptimalControlProblem, fixed_components

LIMIT_TOLERANCE = 1e-3  # fraction of a limit: violation that counts as none


def effort(state, control, weights: Weights) -> Scalar:
    """w_u |u|: Euclidean norm of the rotor thrusts (equation 8)."""
    return weights.control * jnp.sqrt(jnp.sum(control * control))


def flight_time(state, time, weights: Weights) -> Scalar:
    """w_t (t_f - t_0) (equation 8)."""
    return weights.time * time


def in_cone(nodes: int) -> Bool[Array, "nodes"]:
    """The nodes held in the landing cone: the last six, less the very last, which the goal fixes at the apex."""
    index = jnp.arange(nodes)
    return (index >= nodes - 1 - LANDING) & (index < nodes - 1)


class Pose(eqx.Module):
    """Parameters of ``same_pose``."""

    state: Float[Array, "13"]
    """At time zero."""
    velocity: Float[Array, "3"]
    """m/s, of the frame that the state is relative to."""
    fixed: Float[Array, "12"]
    """One where a component is fixed, zero where it is free."""


def same_pose(state, time, p: Pose) -> Float[Array, "12"]:
    """Residual of each fixed component of position, velocity, attitude (three components) and body rate."""
    moved = 0.0 if time is None else p.velocity * time
    position, velocity = state[:3] - (p.state[:3] + moved), state[3:6] - (p.state[3:6] + p.velocity)
    attitude = rotations.attitude_error(state[6:10], p.state[6:10])
    return p.fixed * jnp.concatenate([position, velocity, attitude, state[10:] - p.state[10:]])


def same_pose_unit(state, time, p: Pose) -> Float[Array, "13"]:
    """``same_pose``, and the norm of the quaternion, which the dynamics then keep: for a start with free attitude."""
    return jnp.append(same_pose(state, time, p), 0.5 * (jnp.sum(state[6:10] ** 2) - 1.0))


def landing_problem(
    mission: Mission,
    allocation: Int[Array, "intervals"],
    form: Form = Continuous(),  # noqa: B008
) -> OptimalControlProblem:
    """The mission as an optimal control problem on len(allocation) + 1 nodes.

    Args:
        mission: to plan.
        allocation: polytope of every interval, see ``allocate``; node k has the polytope of interval k.
        form: statement of the problem. By default the final attitude is fixed by the three components of its error.
    """
    nodes = allocation.shape[0] + 1
    initial, final = _boundaries(mission, form)
    return OptimalControlProblem(
        dynamics=mission.airframe.body,
        running_cost=effort,
        terminal_cost=flight_time,
        weights=mission.weights,
        constraints=(
            *_corridor_and_cone(mission, allocation),
            *_flight_limits(mission, nodes),
            *_zones(mission, allocation),
        ),
        initial=initial,
        final=final,
        dilation_min=mission.dilation_min,
        dilation_max=mission.dilation_max,
        nodes=nodes,
        carries_cost=form.carries_cost,
        carries_time=form.carries_time or mission.deck_velocity is not None,
    )


def _boundaries(s: Mission, form: Form) -> tuple[Boundary, Boundary]:
    start, goal = s.start.vector(), s.goal.vector()
    # q and -q are one attitude: take the one nearer to the start's.
    goal = goal.at[6:10].multiply(jnp.where(jnp.dot(start[6:10], goal[6:10]) < 0, -1.0, 1.0))
    everything, still = jnp.ones(13, goal.dtype), jnp.zeros(3, goal.dtype)
    initial = Boundary(fixed_components, FixedComponents(start, everything))
    if s.start_fixed is not None:
        initial = Boundary(same_pose_unit, Pose(start, still, s.start_fixed.vector()))
    if form.fixes_unit_norm and s.goal_fixed is None and s.deck_velocity is None:
        return initial, Boundary(fixed_components, FixedComponents(goal, everything))
    deck = still if s.deck_velocity is None else s.deck_velocity
    which = everything[:12] if s.goal_fixed is None else s.goal_fixed.vector()
    return initial, Boundary(same_pose, Pose(goal, deck, which))


def _corridor_and_cone(s: Mission, allocation: Int[Array, "intervals"]):
    nodes = allocation.shape[0] + 1
    cell = jnp.concatenate([allocation, allocation[-1:]])
    faces = HalfSpaces(s.corridor.normals[cell], s.corridor.offsets[cell])
    everywhere = jnp.ones(nodes, bool)
    yield Constraint(inside_half_spaces, faces, NonNegative(), everywhere, "corridor")
    low, high = s.airframe.thrust_min, s.airframe.thrust_max
    yield Constraint(
        within_control_limits,
        repeat_over_nodes(Limits(low, high), nodes),
        NonNegative(),
        everywhere,
        "thrust",
        AtNodes(),
        allowed=LIMIT_TOLERANCE * jnp.min(high - low),
    )
    velocity = jnp.zeros_like(s.goal.position) if s.deck_velocity is None else s.deck_velocity
    axes = rotations.rotation_matrix(s.goal.attitude)
    cone = LandingCone(s.goal.position, velocity, axes, 1.0 / jnp.tan(s.cone_angle))
    yield Constraint(
        inside_landing_cone, repeat_over_nodes(cone, nodes), SecondOrder(), in_cone(nodes), "landing cone"
    )


def _flight_limits(s: Mission, nodes: int):
    everywhere = jnp.ones(nodes, bool)
    for name, function, allowed in (
        ("speed", within_speed, lambda limit: LIMIT_TOLERANCE * limit),
        (
            "tilt",
            within_tilt,
            lambda limit: jnp.sin(0.5 * (1.0 + LIMIT_TOLERANCE) * limit) - jnp.sin(0.5 * limit),
        ),
        ("body_rate", within_body_rate, lambda limit: LIMIT_TOLERANCE * limit),
    ):
        limit = getattr(s.limits, name)
        if limit is not None:
            yield Constraint(
                function,
                repeat_over_nodes(limit, nodes),
                SecondOrder(),
                everywhere,
                name.replace("_", " "),
                allowed=allowed(limit),
            )
    if s.limits.thrust_rate is not None:
        yield Constraint(
            within_thrust_rate,
            repeat_over_nodes(s.limits.thrust_rate, nodes),
            NonNegative(),
            everywhere,
            "thrust rate",
            AcrossIntervals(),
            allowed=LIMIT_TOLERANCE * s.dilation_min,
        )


def _zones(s: Mission, allocation: Int[Array, "intervals"]):
    nodes = allocation.shape[0] + 1
    if s.keep_out is not None:
        zones = repeat_over_nodes(Zones(s.keep_out.centres, s.keep_out.shapes), nodes)
        yield Constraint(
            outside_zones,
            zones,
            NonNegative(),
            jnp.ones(nodes, bool),
            "keep-out",
            convex=False,
            allowed=DISTANCE_TOLERANCE,
        )
    if s.gates is not None:
        route = route_positions(s.corridor, s.start.position, s.goal.position, allocation)
        chosen = gate_nodes(route, s.gates.centres)
        for number in range(s.gates.centres.shape[0]):
            gate = Zones(s.gates.centres[number], s.gates.shapes[number])
            yield Constraint(
                inside_zone,
                repeat_over_nodes(gate, nodes),
                SecondOrder(),
                jnp.arange(nodes) == chosen[number],
                f"gate {number + 1}",
                AtNodes(),
                allowed=DISTANCE_TOLERANCE * jnp.max(jnp.linalg.norm(gate.shapes, axis=1)),
            )
