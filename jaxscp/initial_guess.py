"""The initial guess (equations 25-26): a double integrator through the corridor, by the same conic step.

Minimise the sum of |a_k| at a fixed flight time, the corridor held at every node and the landing cone at the
last ones. The vehicle is taken level, at hover thrust.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxscp import rotations
from jaxscp.allocation import route_positions
from jaxscp.conic.interior_point import InteriorPoint
from jaxscp.conic.program import Cones, Links, NormCost, Rows, StagedProgram
from jaxscp.landing import in_cone
from jaxscp.mission import LandingScenario
from jaxscp.status import StatusCode
from jaxscp.types import Controls, Nodes, Scalar, States, Vector3

# A guess needs no more: within a percent of the least effort. Its units do what equilibration would.
GUESS_CONIC = InteriorPoint(tolerance=1e-2, refinements=0, equilibration=0)
GUESS_VIOLATION = 1e-3  # of the route, that such a guess may leave the corridor or the cone by
# Of a unit of effort: multipliers then have the size of the slacks, which saves Newton steps.
GUESS_PRICE = 0.1

SHARE_OF_THRUST = (
    0.4  # of what full thrust leaves after hovering: the guess's acceleration, which sets its flight time
)
LEAST_ACCELERATION = 0.5  # m/s^2
LEAST_LENGTH = 0.1  # m, of the unit of length: where start and goal are one


class Guess(eqx.Module):
    """Where the iterations start."""

    states: States
    controls: Controls
    dilation: Nodes
    status: StatusCode
    """How the guess's own conic program ended."""


def initial_guess(scenario: LandingScenario, allocation: Int[Array, "intervals"]) -> Guess:
    """Guess a flight through the corridor.

    Args:
        scenario: what to fly.
        allocation: polytope of every interval; node k obeys that of interval k.

    Returns:
        States, controls and dilation at the nodes; positions are along the route itself if the program fails.
    """
    duration = guess_time(scenario, allocation)
    scenario = eqx.tree_at(lambda s: s.goal, scenario, scenario.goal_at(duration))
    units = Units.of(scenario, allocation, duration)
    program = guess_program(scenario, allocation, units)
    solution = GUESS_CONIC(program)
    nodes = program.nodes
    straight = route_positions(scenario.corridor, scenario.start.position, scenario.goal.position, allocation)
    solved = jnp.all(jnp.isfinite(solution.z)) & (program.violation(solution.z) < GUESS_VIOLATION)
    position = jnp.where(solved, units.origin + units.length * solution.z[:, :3], straight)
    velocity = jnp.where(solved, units.speed * solution.z[:, 3:6], 0.0)
    attitude = _blend_attitudes(scenario.start.attitude, scenario.goal.attitude, nodes)
    states = jnp.concatenate([position, velocity, attitude, jnp.zeros((nodes, 3), position.dtype)], axis=1)
    states = states.at[0].set(scenario.start.vector()).at[-1].set(scenario.goal.vector())
    hover = jnp.clip(
        scenario.airframe.body.hover_thrust(), scenario.airframe.thrust_min, scenario.airframe.thrust_max
    )
    controls = jnp.broadcast_to(hover, (nodes, hover.shape[0]))
    return Guess(states, controls, jnp.full((nodes,), duration), solution.status)


class Units(eqx.Module):
    """What the guess's program is measured in, so that its solution takes as few Newton steps at any scale."""

    origin: Vector3
    """The goal, m."""
    length: Scalar
    """That of the route, m."""
    time: Scalar
    """Two intervals, s."""

    @property
    def speed(self) -> Scalar:
        """m/s."""
        return self.length / self.time

    @classmethod
    def of(cls, scenario: LandingScenario, allocation: Int[Array, "intervals"], duration: Scalar) -> "Units":
        """Units of a flight of a given duration."""
        length = jnp.maximum(_route_length(scenario, allocation), LEAST_LENGTH)
        return cls(scenario.goal.position, length, 2.0 * duration / allocation.shape[0])


def guess_time(scenario: LandingScenario, allocation: Int[Array, "intervals"]) -> Scalar:
    """Flight time of the guess in s: from rest to rest along the route, at a comfortable acceleration."""
    length = _route_length(scenario, allocation)
    body = scenario.airframe.body
    lift = jnp.dot(body.thrust_map[2], scenario.airframe.thrust_max) / body.mass
    spare = SHARE_OF_THRUST * (lift - jnp.linalg.norm(body.gravity))
    duration = 2.0 * jnp.sqrt(length / jnp.maximum(spare, LEAST_ACCELERATION))
    if scenario.limits.speed is not None:
        duration = jnp.maximum(duration, 2.0 * length / scenario.limits.speed)
    return jnp.clip(duration, scenario.dilation_min, scenario.dilation_max)


def _route_length(scenario: LandingScenario, allocation: Int[Array, "intervals"]) -> Scalar:
    route = route_positions(scenario.corridor, scenario.start.position, scenario.goal.position, allocation)
    return jnp.sum(jnp.linalg.norm(jnp.diff(route, axis=0), axis=1))


def guess_program(
    scenario: LandingScenario, allocation: Int[Array, "intervals"], units: Units
) -> StagedProgram:
    """Program (26) over node variables (position, velocity, acceleration), in the given units."""
    nodes = allocation.shape[0] + 1
    dtype = scenario.start.position.dtype
    cell = jnp.concatenate([allocation, allocation[-1:]])
    corridor = scenario.corridor
    faces = corridor.normals[cell]
    distances = (corridor.offsets[cell] - faces @ units.origin) / units.length
    cotangent = 1.0 / jnp.tan(scenario.cone_angle)
    deck = rotations.rotation_matrix(scenario.goal.attitude).T  # rows are the deck's axes
    side = jnp.array([cotangent, 1.0, 1.0], dtype)[:, None] * deck[jnp.array([2, 0, 1])]
    active = in_cone(nodes)[:, None]
    cone_matrix = jnp.where(active[:, :, None], -_pad_columns(side, 9), 0.0)
    cone_offset = jnp.where(active, 0.0, jnp.array([1.0, 0.0, 0.0], dtype))  # the apex is the origin
    acceleration = jnp.zeros(9, dtype).at[6:].set(1.0)
    return StagedProgram(
        hessian=jnp.zeros((nodes, 9, 9), dtype),
        gradient=jnp.zeros((nodes, 9), dtype),
        links=_double_integrator_links(scenario, units, nodes),
        rows=Rows(jnp.concatenate([faces, jnp.zeros((*faces.shape[:2], 6), dtype)], axis=2), distances),
        cones=(Cones(cone_matrix[:, None], cone_offset[:, None]),),
        norm=NormCost(
            jnp.full(nodes, GUESS_PRICE, dtype),
            jnp.broadcast_to(acceleration, (nodes, 9)),
            jnp.zeros((nodes, 9), dtype),
        ),
    )


def _double_integrator_links(scenario: LandingScenario, units: Units, nodes: int) -> Links:
    """Exact first-order hold of p'' = a (equation 25), and both ends fixed in position and velocity."""
    h = 0.5  # an interval, in units of two
    eye, none = jnp.eye(3), jnp.zeros((3, 3))
    before = jnp.block([[eye, h * eye, h**2 / 3.0 * eye], [none, eye, h / 2.0 * eye]])
    after = jnp.block([[-eye, none, h**2 / 6.0 * eye], [none, -eye, h / 2.0 * eye]])
    fixed = _pad_columns(jnp.eye(6), 9)[None]
    zero = jnp.zeros_like(fixed)
    inner = (nodes - 1, 6, 9)
    first, last = (
        jnp.concatenate([(end.position - units.origin) / units.length, end.velocity / units.speed])
        for end in (scenario.start, scenario.goal)
    )
    return Links(
        before=jnp.concatenate([zero, jnp.broadcast_to(before, inner), fixed]),
        after=jnp.concatenate([fixed, jnp.broadcast_to(after, inner), zero]),
        offset=jnp.zeros((nodes + 1, 6)).at[0].set(first).at[-1].set(last),
        soft=jnp.zeros((nodes + 1, 6)),
        weight=jnp.ones(nodes + 1),
    )


def _pad_columns(matrix: Float[Array, "rows columns"], columns: int) -> Float[Array, "rows padded"]:
    return jnp.pad(matrix, ((0, 0), (0, columns - matrix.shape[1])))


def _blend_attitudes(start, goal, nodes: int) -> Float[Array, "nodes 4"]:
    """Normalised linear interpolation along the shorter arc."""
    goal = jnp.where(jnp.dot(start, goal) < 0, -goal, goal)
    share = jnp.linspace(0.0, 1.0, nodes)[:, None]
    blend = (1.0 - share) * start + share * goal
    return jax.vmap(lambda q: q / jnp.maximum(jnp.linalg.norm(q), 1e-9))(blend)
