"""Validation of a mission: errors outside ``jit``, a flag for an element of a batch inside it."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np

from jaxscp.core.arrays import PRECISION, double_precision
from jaxscp.core.errors import InvalidScenario
from jaxscp.core.trees import named_leaves
from jaxscp.core.types import Flag
from jaxscp.landing.allocation import usual_nodes
from jaxscp.landing.deck import deck_doubts
from jaxscp.landing.mission import Mission
from jaxscp.landing.rule import Rule
from jaxscp.landing.rules import rules
from jaxscp.landing.structure import check_parts
from jaxscp.landing.unit_doubts import unit_doubts

_MASKS = ("near_obstacles.present", "near_obstacles.deck")


def validate(scenario: Mission, nodes: int | None = None) -> None:
    """Raise ``InvalidScenario`` unless every rule holds. Compiles nothing.

    Warns of an inertia that no body has: a principal moment above the sum of the other two. Warns of values that are
    likely in another unit, and of a deck that leaves the last polytope before the vehicle can reach it.

    Args:
        scenario: a landing.
        nodes: of its plan; by default as many as ``Planner()`` takes.

    Example:
        >>> import equinox as eqx, jax.numpy as jnp, jaxscp
        >>> scenario = jaxscp.scenarios.platform_to_platform()
        >>> heavy = eqx.tree_at(lambda s: s.airframe.body.mass, scenario, jnp.array(40.0))
        >>> jaxscp.validate(heavy)
        Traceback (most recent call last):
        ...
        jaxscp.core.errors.InvalidScenario: airframe: the rotors cannot carry the weight ...
    """
    if nodes is None:
        nodes = nodes_of(scenario)
    check_types(scenario, nodes)
    concrete = jax.tree.map(np.asarray, scenario)
    broken = [rule.message for rule in _finite(concrete, np) if not rule.holds]
    if not broken:
        broken = [rule.message for rule in rules(concrete, np) if not rule.holds]
    if broken:
        raise InvalidScenario("\n".join(broken))
    with np.errstate(all="ignore"):
        doubts = (*unit_doubts(concrete), *deck_doubts(concrete))
    for doubt in doubts:
        warnings.warn(doubt, stacklevel=2)


def nodes_of(scenario: Mission) -> int:
    """Usual nodes for the legs of a route, by the scenario's shape alone: polytopes and gates."""
    check_parts(scenario)
    gates = 0 if scenario.gates is None else scenario.gates.centres.shape[0]
    return usual_nodes(scenario.corridor.offsets.shape[0] + gates)


def valid(scenario: Mission) -> Flag:
    """Whether every rule holds, as an array: for elements of a batch."""
    with np.errstate(all="ignore"):
        checks = [*_finite(scenario, jnp), *rules(scenario, jnp)]
    return jnp.all(jnp.stack([jnp.asarray(rule.holds) for rule in checks]))


def check_types(scenario: Mission, nodes: int) -> None:
    """Raise ``InvalidScenario`` for parts, shapes and precision: leaves may be ``jax.ShapeDtypeStruct``."""
    if not double_precision():
        raise InvalidScenario(PRECISION)
    if nodes < 2:
        raise InvalidScenario(f"nodes: a flight needs at least 2 nodes, not {nodes}.")
    check_parts(scenario)
    for name, leaf in named_leaves(scenario):
        expected = bool if name in _MASKS else np.float64
        if leaf.dtype != expected:
            hint = "" if expected is bool else ". Was the scenario built before jax_enable_x64 was set?"
            if np.issubdtype(leaf.dtype, np.integer):
                hint = ". Write numbers with a decimal point: 1.0, not 1."
            raise InvalidScenario(f"{name}: expected {np.dtype(expected)}, got {leaf.dtype}{hint}")
    for name, leaf, shape in _expected_shapes(scenario):
        if tuple(leaf.shape) != shape:
            raise InvalidScenario(f"{name}: expected shape {shape}, got {tuple(leaf.shape)}.")
    polytopes = scenario.corridor.normals.shape[0]
    if polytopes > nodes - 1:
        raise InvalidScenario(
            f"corridor: {polytopes} polytopes need at least {polytopes + 1} nodes, one interval each, not {nodes}."
        )
    gates = 0 if scenario.gates is None else scenario.gates.centres.shape[0]
    if gates + polytopes > nodes - 1:
        raise InvalidScenario(
            f"gates: the {gates} gates and the joints of {polytopes} polytopes part the route into {gates + polytopes} "
            f"legs, which need at least {gates + polytopes + 1} nodes, one interval each, not {nodes}."
        )


def _expected_shapes(s: Mission):
    rotors = s.airframe.body.thrust_map.shape[-1] if s.airframe.body.thrust_map.ndim else 0
    polytopes, faces = (*s.corridor.offsets.shape, 0, 0)[:2]
    yield "airframe.body.mass", s.airframe.body.mass, ()
    yield "airframe.body.inertia", s.airframe.body.inertia, (3, 3)
    yield "airframe.body.thrust_map", s.airframe.body.thrust_map, (3, rotors)
    yield "airframe.body.torque_map", s.airframe.body.torque_map, (3, rotors)
    yield "airframe.body.gravity", s.airframe.body.gravity, (3,)
    yield "airframe.thrust_min", s.airframe.thrust_min, (rotors,)
    yield "airframe.thrust_max", s.airframe.thrust_max, (rotors,)
    yield "airframe.radius", s.airframe.radius, ()
    for name in ("start", "goal"):
        state = getattr(s, name)
        yield f"{name}.position", state.position, (3,)
        yield f"{name}.velocity", state.velocity, (3,)
        yield f"{name}.attitude", state.attitude, (4,)
        yield f"{name}.body_rate", state.body_rate, (3,)
    yield "corridor.offsets", s.corridor.offsets, (polytopes, faces)
    yield "corridor.normals", s.corridor.normals, (polytopes, faces, 3)
    yield "corridor.joints", s.corridor.joints, (max(polytopes - 1, 0), 3)
    if s.corridor.margin is not None:
        yield "corridor.margin", s.corridor.margin, ()
    for name in ("cone_angle", "dilation_min", "dilation_max", "recovery"):
        yield name, getattr(s, name), ()
    for name in ("speed", "tilt", "body_rate", "thrust_rate"):
        if getattr(s.limits, name) is not None:
            yield f"limits.{name}", getattr(s.limits, name), ()
    for name in ("keep_out", "gates"):
        zones = getattr(s, name)
        if zones is not None:
            count = zones.centres.shape[0] if zones.centres.ndim else 0
            yield f"{name}.centres", zones.centres, (count, 3)
            yield f"{name}.shapes", zones.shapes, (count, 3, 3)
    if s.deck_velocity is not None:
        yield "deck_velocity", s.deck_velocity, (3,)
    for name in ("start_fixed", "goal_fixed"):
        if getattr(s, name) is not None:
            for part in ("position", "velocity", "attitude", "body_rate"):
                yield f"{name}.{part}", getattr(getattr(s, name), part), (3,)
    if s.near_obstacles is not None:
        points = s.near_obstacles.points.shape[0] if s.near_obstacles.points.ndim else 0
        for part, shape in (("points", (points, 3)), ("present", (points,)), ("deck", (points,))):
            yield f"near_obstacles.{part}", getattr(s.near_obstacles, part), shape
        yield "near_obstacles.spread", s.near_obstacles.spread, ()
        yield "near_obstacles.reach", s.near_obstacles.reach, ()
    yield "weights.control", s.weights.control, ()
    yield "weights.time", s.weights.time, ()


def _finite(scenario: Mission, xp):
    for name, leaf in named_leaves(scenario):
        yield Rule(xp.all(xp.isfinite(leaf)), f"{name}: holds a value that is NaN or infinite.")
