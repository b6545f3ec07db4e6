"""The mission as an optimal control problem: leave a deck, fly a corridor, land in a cone (equations 20-24)."""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxscp.cones.cone import Cone, NonNegative, SecondOrder
from jaxscp.core.types import Scalar
from jaxscp.dynamics import rotations
from jaxscp.landing.allocation import LANDING, gate_nodes
from jaxscp.landing.constraints import (
    HalfSpaces,
    LandingCone,
    Limits,
    Zones,
    inside_half_spaces,
    inside_landing_cone,
    inside_moving_landing_cone,
    inside_zone,
    outside_zones,
    within_body_rate,
    within_control_limits,
    within_speed,
    within_thrust_rate,
    within_tilt,
)
from jaxscp.landing.mission import Mission, Weights
from jaxscp.landing.recovery import limits_at_nodes, wall_relief, zones_at_nodes
from jaxscp.landing.sizes import TYPICAL_TIME, sizes_of
from jaxscp.problem.boundary import Boundary, EndCondition, EndRows
from jaxscp.problem.constraint import (
    DISTANCE_TOLERANCE,
    AcrossIntervals,
    AtNodes,
    Constraint,
    Throughout,
    Where,
    repeat_over_nodes,
)
from jaxscp.problem.cost import Cost
from jaxscp.problem.form import Continuous, Form
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.problem.time import FreeTime, Time

LIMIT_TOLERANCE = 1e-3  # fraction of a limit: violation that counts as none
# Errors at an end that count as none; a millimetre of position is ``DISTANCE_TOLERANCE``.
ANGLE_TOLERANCE = 1.75e-3  # rad: 0.1 degree
SPEED_TOLERANCE = 1e-2  # m/s
RATE_TOLERANCE = 1e-2  # rad/s
MESH_WEIGHT = 1e-4  # in units of a mission's cost; three times as much raises some costs by 0.1 %


def effort(state, control, time, weights: Weights) -> Scalar:
    """w_u |u|: Euclidean norm of the rotor thrusts (equation 8)."""
    return weights.control * jnp.sqrt(jnp.sum(control * control))


def flight_time(state, time, weights: Weights) -> Scalar:
    """w_t (t_f - t_0) (equation 8)."""
    return weights.time * time


def in_cone(nodes: int) -> Bool[Array, "nodes"]:
    """The nodes held in the landing cone: the last six, less the very last, which the goal fixes at the apex."""
    index = jnp.arange(nodes)
    return (index >= nodes - 1 - LANDING) & (index < nodes - 1)


class FixedComponents(eqx.Module):
    """Parameters of ``fixed_components``."""

    value: Float[Array, "states"]
    fixed: Float[Array, "states"]
    """One where a component is fixed, zero where it is free."""


def fixed_components(state, time, p: FixedComponents) -> Float[Array, "states"]:
    """Each fixed component of the state at its value (equation 24)."""
    return p.fixed * (state - p.value)


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
    return _pose_error(state, p, 0.0)


def same_moving_pose(state, time, p: Pose) -> Float[Array, "12"]:
    """``same_pose``, at a position that moves."""
    return _pose_error(state, p, p.velocity * time)


def _pose_error(state, p: Pose, moved) -> Float[Array, "12"]:
    position, velocity = state[:3] - (p.state[:3] + moved), state[3:6] - (p.state[3:6] + p.velocity)
    attitude = rotations.attitude_error(state[6:10], p.state[6:10])
    return p.fixed * jnp.concatenate([position, velocity, attitude, state[10:] - p.state[10:]])


def attitude_angle(residual: Float[Array, "_"]) -> Scalar:
    """Angle of a rotation, from the residual of its end condition.

    The residual is the difference of two quaternions (4,), of length 2 sin(angle / 4), or a vector part (3,), of length
    sin(angle / 2).
    """
    length = jnp.linalg.norm(residual)
    if residual.shape[0] == 4:
        return 4.0 * jnp.arcsin(jnp.minimum(0.5 * length, 1.0))
    return 2.0 * jnp.arcsin(jnp.minimum(length, 1.0))


def pose_rows(attitude: int) -> tuple[EndRows, ...]:
    """Rows of a condition on a pose, with that many components of the attitude."""
    return (
        EndRows("position", "m", 3, DISTANCE_TOLERANCE),
        EndRows("velocity", "m/s", 3, SPEED_TOLERANCE),
        EndRows("attitude", "rad", attitude, ANGLE_TOLERANCE, attitude_angle),
        EndRows("body rate", "rad/s", 3, RATE_TOLERANCE),
    )


UNIT_NORM = EndRows("quaternion norm", "", 1, ANGLE_TOLERANCE)


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
        allocation: leg of every interval, see ``allocate``; node k has the polytope of interval k.
        form: statement of the problem. By default the final attitude is fixed by the three components of its error.
    """
    nodes, mission = allocation.shape[0] + 1, mission.with_unit_directions()
    route = jax.lax.stop_gradient(mission).route()
    return OptimalControlProblem(
        dynamics=mission.airframe.body,
        cost=Cost(effort, flight_time, mission.weights),
        boundary=Boundary(*_ends(mission, form)),
        time=Time(nodes, FreeTime(mission.dilation_min, mission.dilation_max), *_evenness(mission, form)),
        constraints=(
            *_corridor_and_cone(mission, route.polytope[allocation]),
            *_flight_limits(mission, nodes),
            *_zones(mission, nodes, gate_nodes(route, allocation)),
        ),
    )


def _evenness(mission: Mission, form: Form) -> tuple[Scalar, Scalar] | tuple[None, None]:
    """Weight and unit of the cost of an uneven mesh: the same in the solver's units for every mission.

    They have derivatives. So the optimum is the same function of the mission in all units.
    """
    if not form.even_mesh:
        return None, None
    sizes = sizes_of(mission)
    return MESH_WEIGHT * sizes.cost, TYPICAL_TIME * sizes.time


def _ends(s: Mission, form: Form) -> tuple[EndCondition, EndCondition]:
    start, goal = s.start.vector(), s.goal.vector()
    # q and -q are one attitude: take the one nearer to the start's.
    goal = goal.at[6:10].multiply(jnp.where(jnp.dot(start[6:10], goal[6:10]) < 0, -1.0, 1.0))
    everything, still = jnp.ones(13, goal.dtype), jnp.zeros(3, goal.dtype)
    initial = EndCondition(fixed_components, FixedComponents(start, everything), pose_rows(4))
    if s.start_fixed is not None:
        pose = Pose(start, still, s.start_fixed.vector())
        initial = EndCondition(same_pose_unit, pose, (*pose_rows(3), UNIT_NORM))
    if form.fixes_unit_norm and s.goal_fixed is None and s.deck_velocity is None:
        return initial, EndCondition(fixed_components, FixedComponents(goal, everything), pose_rows(4))
    which = everything[:12] if s.goal_fixed is None else s.goal_fixed.vector()
    if s.deck_velocity is None:
        return initial, EndCondition(same_pose, Pose(goal, still, which), pose_rows(3))
    return initial, EndCondition(same_moving_pose, Pose(goal, s.deck_velocity, which), pose_rows(3))


def _corridor_and_cone(s: Mission, polytope: Int[Array, "intervals"]):
    nodes = polytope.shape[0] + 1
    cell = jnp.concatenate([polytope, polytope[-1:]])
    faces = HalfSpaces(s.corridor.normals[cell], s.corridor.offsets[cell] + wall_relief(s, cell))
    everywhere = jnp.ones(nodes, bool)
    yield _per_node("corridor", inside_half_spaces, NonNegative(), faces, everywhere)
    low, high = s.airframe.thrust_min, s.airframe.thrust_max
    yield _per_node(
        "thrust",
        within_control_limits,
        NonNegative(),
        repeat_over_nodes(Limits(low, high), nodes),
        everywhere,
        AtNodes(),
        LIMIT_TOLERANCE * jnp.min(high - low),
    )
    moves = s.deck_velocity is not None
    velocity = jnp.zeros_like(s.goal.position) if s.deck_velocity is None else s.deck_velocity
    axes = rotations.rotation_matrix(s.goal.attitude)
    cone = LandingCone(s.goal.position, velocity, axes, 1.0 / jnp.tan(s.cone_angle))
    function = inside_moving_landing_cone if moves else inside_landing_cone
    yield _per_node("landing cone", function, SecondOrder(), repeat_over_nodes(cone, nodes), in_cone(nodes))


def _per_node(
    name: str,
    function: Callable[..., Any],
    cone: Cone,
    parameters: Any,
    active: Bool[Array, "nodes"],
    where: Where = Throughout(),  # noqa: B008
    tolerance: Any = DISTANCE_TOLERANCE,
) -> Constraint:
    """A convex constraint whose parameters have the nodes as leading axis."""
    return Constraint(
        function,
        cone,
        parameters,
        per_node=True,
        active=active,
        where=where,
        convex=True,
        tolerance=tolerance,
        name=name,
    )


def _flight_limits(s: Mission, nodes: int):
    everywhere, at_nodes = jnp.ones(nodes, bool), limits_at_nodes(s, nodes)
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
            yield _per_node(
                name.replace("_", " "),
                function,
                SecondOrder(),
                getattr(at_nodes, name),
                everywhere,
                tolerance=allowed(limit),
            )
    if s.limits.thrust_rate is not None:
        yield _per_node(
            "thrust rate",
            within_thrust_rate,
            NonNegative(),
            repeat_over_nodes(s.limits.thrust_rate, nodes),
            everywhere,
            AcrossIntervals(),
            LIMIT_TOLERANCE * s.dilation_min,
        )


def _zones(s: Mission, nodes: int, at_gates: Int[Array, "gates"]):
    if s.keep_out is not None and s.keep_out.centres.shape[0]:
        zones = Zones(*zones_at_nodes(s, s.keep_out, nodes))
        everywhere = jnp.ones(nodes, bool)
        keep_out = _per_node("keep-out", outside_zones, NonNegative(), zones, everywhere)
        yield dataclasses.replace(keep_out, convex=False)
    if s.gates is not None:
        for number in range(s.gates.centres.shape[0]):
            gate = Zones(s.gates.centres[number], s.gates.shapes[number])
            yield _per_node(
                f"gate {number + 1}",
                inside_zone,
                SecondOrder(),
                repeat_over_nodes(gate, nodes),
                jnp.arange(nodes) == at_gates[number],
                AtNodes(),
                DISTANCE_TOLERANCE * jnp.max(jnp.linalg.norm(gate.shapes, axis=1)),
            )
