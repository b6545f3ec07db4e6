"""The guess: a smooth path through the corridor by the conic solver, and the states and controls along it.

As in the paper (equations 25-26), the flight time is fixed, the corridor holds at every node, and the landing cone at
the last ones. The paper's path is a double integrator's of least sum |a_k|: it accelerates at a few nodes only, and the
vehicle is level at hover thrust. Here the path has a piecewise linear jerk and least

    sum |a_k|^2 + (SMOOTHING t_f)^2 |j_k|^2.

Attitudes, body rates and thrusts follow from it (``flatness``). The guess then almost satisfies the dynamics, which
saves a fifth of the iterations.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxscp.conic.interior_point import InteriorPoint
from jaxscp.conic.program import Cones, CouplingRows, HalfSpaceRows, StagedProgram
from jaxscp.core.status import StatusCode
from jaxscp.core.trees import tree_where
from jaxscp.core.types import Controls, Nodes, Points, Scalar, States, Vector3
from jaxscp.dynamics import flatness, rotations
from jaxscp.landing.allocation import gate_nodes, route_positions
from jaxscp.landing.mission import BodyState, Mission
from jaxscp.landing.problem import in_cone

# A guess needs no more: within a third of the effort along a straight line. Its units replace equilibration.
GUESS_CONIC = InteriorPoint(tolerance=1e-2, refinements=0, equilibration=0)
GUESS_VIOLATION = 1e-3  # of the route's length: allowed violation of the corridor or the cone
GUESS_COST = 0.03  # of a trajectory from rest to rest on a straight line
SMOOTHING = 0.03  # fraction of the flight time in which accelerations change

THRUST_FRACTION = (
    0.48  # of full thrust beyond hovering: gives the guess's acceleration, and so its flight time
)
LEAST_ACCELERATION = 0.5  # m/s^2
LEAST_LENGTH = 0.1  # m, of the unit of length: where start and goal are one

VARIABLES = 12  # of a node: position, velocity, acceleration and jerk


class Guess(eqx.Module):
    """States, controls and dilation to start from."""

    states: States
    controls: Controls
    dilation: Nodes
    status: StatusCode
    """Status of the guess's conic program."""


def initial_guess(scenario: Mission, allocation: Int[Array, "intervals"]) -> Guess:
    """Guess a trajectory through the corridor.

    Args:
        scenario: to plan.
        allocation: leg of every interval; node k has the polytope of interval k.

    Returns:
        States, controls and dilation at the nodes; positions are along the route itself if the program fails.
    """
    scenario = scenario.with_unit_directions()
    duration = guess_time(scenario, allocation)
    scenario = eqx.tree_at(lambda s: s.goal, scenario, scenario.goal_at(duration))
    units = Units.of(scenario, allocation, duration)
    program = guess_program(scenario, allocation, units)
    solution = GUESS_CONIC(program)
    path = units.of_path(solution.z)
    straight = route_positions(scenario.route(), allocation)
    solved = jnp.all(jnp.isfinite(solution.z)) & (program.violation(solution.z) < GUESS_VIOLATION)
    still = jnp.zeros_like(straight)
    path = tree_where(solved, path, (straight, still, still))
    states, controls = _states_and_controls(scenario, path, duration / allocation.shape[0])
    return Guess(states, controls, jnp.full((program.nodes,), duration), solution.status)


def _states_and_controls(
    scenario: Mission, path: tuple[Points, Points, Points], interval: Scalar
) -> tuple[States, Controls]:
    """States and controls along a path of positions, velocities and accelerations; both ends as the mission says."""
    position, velocity, acceleration = path
    nodes, airframe = position.shape[0], scenario.airframe
    start, goal = scenario.start, scenario.goal
    inner = (jnp.arange(nodes) % (nodes - 1) > 0)[:, None]
    blended = rotations.blend(start.attitude, goal.attitude, nodes)
    attitude = jnp.where(inner, flatness.attitudes(airframe.body, acceleration, blended), blended)
    rates = jnp.linspace(start.body_rate, goal.body_rate, nodes)
    rates = jnp.where(inner, flatness.body_rates(attitude, interval), rates)
    controls = flatness.thrusts(airframe.body, acceleration, rates, interval)
    controls = jnp.clip(controls, airframe.thrust_min, airframe.thrust_max)
    moving = jnp.concatenate([position, velocity], axis=1)
    moving = moving.at[0].set(start.vector()[:6]).at[-1].set(goal.vector()[:6])
    return jnp.concatenate([moving, attitude, rates], axis=1), controls


class Units(eqx.Module):
    """Units of the guess's program: its solution takes as few Newton steps at any scale."""

    origin: Vector3
    """The goal, m."""
    length: Scalar
    """Length of the route, m."""
    time: Scalar
    """Two intervals, s."""

    @property
    def speed(self) -> Scalar:
        """m/s."""
        return self.length / self.time

    @property
    def acceleration(self) -> Scalar:
        """m/s^2."""
        return self.speed / self.time

    def of_path(self, z: Float[Array, "nodes 12"]) -> tuple[Points, Points, Points]:
        """Positions, velocities and accelerations in the world, from the program's variables."""
        position, velocity, acceleration, _ = jnp.split(z, 4, axis=1)
        return self.origin + self.length * position, self.speed * velocity, self.acceleration * acceleration

    def end(self, scenario: Mission, state: BodyState) -> Float[Array, "9"]:
        """Position, velocity and acceleration at an end; the acceleration follows from hover thrust at its attitude."""
        body = scenario.airframe.body
        acceleration = body(state.vector(), body.hover_thrust())[3:6]
        position = (state.position - self.origin) / self.length
        return jnp.concatenate([position, state.velocity / self.speed, acceleration / self.acceleration])

    @classmethod
    def of(cls, scenario: Mission, allocation: Int[Array, "intervals"], duration: Scalar) -> "Units":
        """Units of a trajectory of a given duration."""
        length = jnp.maximum(_route_length(scenario, allocation), LEAST_LENGTH)
        return cls(scenario.goal.position, length, 2.0 * duration / allocation.shape[0])


def guess_time(scenario: Mission, allocation: Int[Array, "intervals"]) -> Scalar:
    """Flight time of the guess in s: from rest to rest along the route, at a comfortable acceleration."""
    length = _route_length(scenario, allocation)
    body = scenario.airframe.body
    lift = jnp.dot(body.thrust_map[2], scenario.airframe.thrust_max) / body.mass
    spare = THRUST_FRACTION * (lift - jnp.linalg.norm(body.gravity))
    duration = 2.0 * jnp.sqrt(length / jnp.maximum(spare, LEAST_ACCELERATION))
    if scenario.limits.speed is not None:
        duration = jnp.maximum(duration, 2.0 * length / scenario.limits.speed)
    return jnp.clip(duration, scenario.dilation_min, scenario.dilation_max)


def _route_length(scenario: Mission, allocation: Int[Array, "intervals"]) -> Scalar:
    route = route_positions(scenario.route(), allocation)
    return jnp.sum(jnp.linalg.norm(jnp.diff(route, axis=0), axis=1))


def guess_program(scenario: Mission, allocation: Int[Array, "intervals"], units: Units) -> StagedProgram:
    """The path's program over node variables (position, velocity, acceleration, jerk), in the given units."""
    nodes = allocation.shape[0] + 1
    dtype = scenario.start.position.dtype
    faces, offsets = _half_spaces(scenario, allocation)
    distances = (offsets - faces @ units.origin) / units.length
    cotangent = 1.0 / jnp.tan(scenario.cone_angle)
    deck = rotations.rotation_matrix(scenario.goal.attitude).T  # rows are the deck's axes
    side = jnp.array([cotangent, 1.0, 1.0], dtype)[:, None] * deck[jnp.array([2, 0, 1])]
    active = in_cone(nodes)[:, None]
    cone_matrix = jnp.where(active[:, :, None], -_pad_columns(side, VARIABLES), 0.0)
    cone_offset = jnp.where(active, 0.0, jnp.array([1.0, 0.0, 0.0], dtype))  # the apex is the origin
    return StagedProgram(
        hessian=jnp.broadcast_to(jnp.diag(_weights(nodes, dtype)), (nodes, VARIABLES, VARIABLES)),
        gradient=jnp.zeros((nodes, VARIABLES), dtype),
        links=_triple_integrator_links(scenario, units, nodes),
        rows=HalfSpaceRows(_pad_columns(faces, VARIABLES), distances),
        cones=(Cones(cone_matrix[:, None], cone_offset[:, None]),),
    )


def _half_spaces(
    scenario: Mission, allocation: Int[Array, "intervals"]
) -> tuple[Float[Array, "nodes faces 3"], Float[Array, "nodes faces"]]:
    """Normals and offsets, m, of every node's half-spaces: of its polytope, and of a box inside its gate, if any."""
    route, corridor = scenario.route(), scenario.corridor
    polytope = route.polytope[allocation]
    cell = jnp.concatenate([polytope, polytope[-1:]])
    faces, offsets = corridor.normals[cell], corridor.offsets[cell]
    gates, at = scenario.gates, gate_nodes(route, allocation)
    if gates is None:
        return faces, offsets
    sides = jnp.concatenate([gates.shapes, -gates.shapes], axis=1)
    reach = jnp.einsum("gfc,gc->gf", sides, gates.centres) + jnp.sqrt(
        1.0 / 3.0
    )  # of a cube inside the unit ball
    none = jnp.zeros((faces.shape[0], *sides.shape[1:]), faces.dtype)
    more = none.at[at].set(sides), jnp.ones(none.shape[:2], offsets.dtype).at[at].set(reach)
    return jnp.concatenate([faces, more[0]], axis=1), jnp.concatenate([offsets, more[1]], axis=1)


def _weights(nodes: int, dtype) -> Float[Array, "12"]:
    """Weights of the variables' squares, halved, in units of the route and of two intervals."""
    duration = 0.5 * (nodes - 1)
    effort = nodes * (4.0 / duration**2) ** 2  # from rest to rest along one unit of length
    acceleration = GUESS_COST / effort
    each = jnp.array([0.0, 0.0, acceleration, acceleration * (SMOOTHING * duration) ** 2], dtype)
    return jnp.repeat(2.0 * each, 3)


def _triple_integrator_links(scenario: Mission, units: Units, nodes: int) -> CouplingRows:
    """Exact first-order hold of the jerk, and both ends fixed in position, velocity and acceleration."""
    h = 0.5  # an interval, in units of two
    eye, none = jnp.eye(3), jnp.zeros((3, 3))
    before = jnp.block(
        [
            [eye, h * eye, h**2 / 2.0 * eye, h**3 / 8.0 * eye],
            [none, eye, h * eye, h**2 / 3.0 * eye],
            [none, none, eye, h / 2.0 * eye],
        ]
    )
    after = jnp.block(
        [
            [-eye, none, none, h**3 / 24.0 * eye],
            [none, -eye, none, h**2 / 6.0 * eye],
            [none, none, -eye, h / 2.0 * eye],
        ]
    )
    fixed = _pad_columns(jnp.eye(9), VARIABLES)[None]
    zero = jnp.zeros_like(fixed)
    inner = (nodes - 1, 9, VARIABLES)
    first, last = units.end(scenario, scenario.start), units.end(scenario, scenario.goal)
    return CouplingRows(
        before=jnp.concatenate([zero, jnp.broadcast_to(before, inner), fixed]),
        after=jnp.concatenate([fixed, jnp.broadcast_to(after, inner), zero]),
        offset=jnp.zeros((nodes + 1, 9)).at[0].set(first).at[-1].set(last),
        soft=jnp.zeros((nodes + 1, 9)),
        weight=jnp.ones(nodes + 1),
    )


def _pad_columns(matrix: Float[Array, "*b columns"], columns: int) -> Float[Array, "*b padded"]:
    return jnp.pad(matrix, [(0, 0)] * (matrix.ndim - 1) + [(0, columns - matrix.shape[-1])])
