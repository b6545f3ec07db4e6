"""Scenarios and corridors: random ones that can be flown, and mutations of these."""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxscp
from benchmarks.fuzz.case import Case, Ending, any_of, refused
from benchmarks.fuzz.oracle import World, faults
from benchmarks.fuzz.places import chain, walls
from jaxscp.corridor import box, connect, obstacles_near
from jaxscp.dynamics.airframes import multirotor

PLANNER = jaxscp.Planner(nodes=16)
NEAR = 2048  # points
VALID = 0.65  # of these kinds: others have fewer plans
HULL = 0.076  # m, of the paper's vehicle
WRONG_NUMBER = "a wrong number"


def planned(make: Callable[[], tuple[Any, World]], planner: jaxscp.Planner = PLANNER) -> Ending:
    """Plan a scenario and judge, in its world, a plan that claims to have converged."""
    try:
        scenario, world = make()
        solution = jax.block_until_ready(planner(scenario))
    except (ValueError, MemoryError) as error:
        return refused(error)
    name = str(jaxscp.status_names(solution.status))
    if name != "converged":
        return Ending(name, solution.cause())
    found = faults(scenario, solution, world)
    if not found:
        return Ending("converged")
    return Ending("nan" if found.startswith("NaN") else "refuted", found)


def _random(rng: np.random.Generator, rooms: int) -> tuple[jaxscp.LandingScenario, World]:
    """A scenario that can be flown, and its world."""
    boxes, start, goal = chain(rng, rooms)
    margin = HULL + 0.05
    corridor = connect([box(*b) for b in boxes], margin=margin)
    ends = jaxscp.at_rest(start, rng.uniform(-3, 3)), jaxscp.at_rest(goal, rng.uniform(-3, 3))
    parts: dict[str, Any] = {"weights": jaxscp.Weights(10.0 ** rng.uniform(-2, 2), rng.choice([0.0, 5.0]))}
    if rng.random() < 0.3:
        size = 10.0 ** rng.uniform(-0.5, 0.8)
        parts["airframe"] = multirotor(
            mass=0.9 * size**3,
            inertia=np.array([2.5e-3, 2.1e-3, 4.3e-3]) * size**5,
            arm=0.05,
            torque_ratio=0.016 * size,
            thrust_min=0.2 * size**3,
            thrust_max=5.0 * size**3,
        )
    if rooms == 1:
        parts["limits"] = jaxscp.flight_limits(speed=rng.uniform(2, 5), tilt=rng.uniform(0.5, 1.2))
    return jaxscp.scenarios.through(corridor, *ends, **parts), World(free=boxes, margin=margin)


def scenario(rng: np.random.Generator) -> Case:
    """A scenario in one room with limits, or in three without; or a mutation of one."""
    name = any_of(rng, MUTATIONS, VALID)
    made, world = _random(rng, int(rng.choice([1, 3])))

    def make():
        if not name:
            return made, world
        changed = MUTATIONS[name](made, rng)
        moved = name == WRONG_NUMBER and not eqx.tree_equal(changed.corridor, made.corridor)
        return changed, as_stated(changed.corridor, world) if moved else world

    return Case("scenario", name, lambda: planned(make))


def as_stated(corridor: Any, world: World) -> World:
    """The world where a number moved a face of the corridor: another corridor, whose polytopes are the truth."""
    cells = tuple(zip(np.asarray(corridor.normals), np.asarray(corridor.offsets), strict=True))
    return world._replace(free=(), margin=0.0, cells=cells)


def _at(where: Callable[[Any], Any], change: Callable[[np.ndarray, np.random.Generator], Any]):
    def mutate(made, rng):
        return eqx.tree_at(where, made, jnp.asarray(change(np.array(where(made)), rng)))

    return mutate


def _leaf(made, rng: np.random.Generator) -> Any:
    """A random number of a random leaf becomes a random wrong one."""
    leaves, tree = jax.tree.flatten(made)
    row = int(rng.integers(len(leaves)))
    value = np.array(leaves[row])
    value.reshape(-1)[rng.integers(value.size)] = rng.choice(
        [np.nan, np.inf, -np.inf, 0.0, -1.0, 1e300, 1e-300, 1e6]
    )
    leaves[row] = jnp.asarray(value)
    return jax.tree.unflatten(tree, leaves)


def _shape(made, rng: np.random.Generator) -> Any:
    leaves, tree = jax.tree.flatten(made)
    row = int(rng.integers(len(leaves)))
    leaves[row] = jnp.concatenate([jnp.ravel(leaves[row])] * 2)
    return jax.tree.unflatten(tree, leaves)


def _none(made, rng: np.random.Generator) -> Any:
    names = [f.name for f in dataclasses.fields(made)]
    return dataclasses.replace(made, **{str(rng.choice(names)): None})


def _mixed(made, rng: np.random.Generator) -> Any:
    """Normals of any length: the same polytopes."""
    factors = jnp.asarray(10.0 ** rng.uniform(-5, 3, made.corridor.offsets.shape))
    parts = made.corridor.normals * factors[..., None], made.corridor.offsets * factors
    return eqx.tree_at(lambda s: (s.corridor.normals, s.corridor.offsets), made, parts)


MUTATIONS: dict[str, Callable[..., Any]] = {
    WRONG_NUMBER: _leaf,
    "a wrong shape": _shape,
    "a part is None": _none,
    "normals of any length": _mixed,
    "quaternion not of unit norm": _at(
        lambda s: s.start.attitude, lambda q, r: q * r.choice([0.9991, 1.0009, 2.0, 0.0])
    ),
    "quaternion of the opposite sign": _at(lambda s: s.goal.attitude, lambda q, r: -q),
    "start outside": _at(lambda s: s.start.position, lambda p, r: p + r.choice([-1, 1], 3) * 3.0),
    "goal at the border": _at(lambda s: s.goal.position, lambda p, r: p + np.array([0, 0, 5.0])),
    "mass of another unit": _at(lambda s: s.airframe.body.mass, lambda m, r: m * r.choice([1e-3, 1e3])),
    "inertia of another unit": _at(lambda s: s.airframe.body.inertia, lambda j, r: j * r.choice([1e3, 1e6])),
    "angle in degrees": _at(lambda s: s.cone_angle, lambda a, r: np.degrees(a)),
    "little thrust": _at(lambda s: s.airframe.thrust_max, lambda t, r: t * r.uniform(0.0, 0.6)),
    "little time": _at(lambda s: s.dilation_max, lambda t, r: r.uniform(0.5, 1.2)),
    "joints in disorder": _at(lambda s: s.corridor.joints, lambda j, r: j[::-1] if len(j) else j),
    "fast start": _at(lambda s: s.start.velocity, lambda v, r: r.uniform(-6, 6, 3)),
    "spinning start": _at(lambda s: s.start.body_rate, lambda v, r: r.uniform(-30, 30, 3)),
    "tilted goal": _at(lambda s: s.goal.attitude, lambda q, r: (v := r.normal(size=4)) / np.linalg.norm(v)),
    "numbers of NumPy and Python": lambda s, r: eqx.tree_at(
        lambda s: s.airframe.body.mass, s, float(s.airframe.body.mass)
    ),
}


def corridor(rng: np.random.Generator) -> Case:
    """A corridor by hand among the points of its walls, with a margin; or made wrongly."""
    name = any_of(rng, CORRIDORS, VALID)
    boxes, start, goal = chain(rng, 3)
    points, radius = walls(boxes), float(rng.uniform(0.05, 0.3))
    frame = dataclasses.replace(jaxscp.airframes.paper_mav(), radius=radius)
    cells, margin = CORRIDORS[name](list(boxes), radius, rng) if name else (list(boxes), radius)

    def make():
        made = connect([box(*cell) for cell in cells], margin=margin)
        near = obstacles_near(made, points, 0.35, size=NEAR)
        ends = jaxscp.at_rest(start), jaxscp.at_rest(goal)
        scenario = jaxscp.scenarios.through(made, *ends, airframe=frame, near_obstacles=near)
        return scenario, World(points=points, least_points=radius)

    return Case("corridor", name, lambda: planned(make))


CORRIDORS: dict[str, Callable[..., tuple[list, float]]] = {
    "no margin": lambda boxes, radius, rng: (boxes, 0.0),
    "too little margin": lambda boxes, radius, rng: (boxes, 0.5 * radius),
    "negative margin": lambda boxes, radius, rng: (boxes, -radius),
    "too much margin": lambda boxes, radius, rng: (boxes, 3.0),
    "margin is NaN": lambda boxes, radius, rng: (boxes, float("nan")),
    "rooms in disorder": lambda boxes, radius, rng: ([boxes[0], boxes[2], boxes[1]], radius),
    "rooms reversed": lambda boxes, radius, rng: (boxes[::-1], radius),
    "a room is missing": lambda boxes, radius, rng: ([boxes[0], boxes[2]], radius),
    "corners swapped": lambda boxes, radius, rng: ([(high, low) for low, high in boxes], radius),
    "a room is flat": lambda boxes, radius, rng: ([boxes[0], (boxes[1][0], boxes[1][0]), boxes[2]], radius),
    "no room": lambda boxes, radius, rng: ([], radius),
    "a room is too large": lambda boxes, radius, rng: (
        [boxes[0], (boxes[1][0] - 1.0, boxes[1][1] + 1.0), boxes[2]],
        radius,
    ),
}
