"""Cases of missions, drawn from a seed: obstacles, goal, vehicle, air and the motion of the deck."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from jaxscp.core.arrays import is_whole
from jaxscp.core.types import Scalar, Vector3
from jaxscp.dynamics.airframes import Airframe
from jaxscp.mission.fields import FIELDS, MOST_DECK_SPEED, MOST_SEED, MOST_WIND, Field
from jaxscp.simulation import Aerodynamics, LiDAR, Scene, World, indoor, outdoor, simulated_mav
from jaxscp.simulation.course import Course

_WALL = 0.2  # half thickness of the hall's walls, m
_FREE = 1.0  # m, from the goal to the nearest obstacle
_TRIALS = 200  # places for the goal


class Case(eqx.Module):
    """One mission: the world that the judge knows, and the task that the vehicle knows."""

    world: World
    scene: Scene
    lidar: LiDAR
    goal: Vector3
    """Of the task, m, world axes."""
    key: PRNGKeyArray
    """Seed of all noise."""
    field: Field = eqx.field(static=True)


@dataclasses.dataclass(frozen=True)
class Choices:
    """Numbers that are fixed instead of drawn."""

    wind: float | None = None
    """Mean wind, m/s."""
    deck_speed: float | None = None
    """Speed of the deck in a landing, m/s."""
    vary: bool = True
    """Whether mass, inertia, thrust and suction vary."""

    def __post_init__(self) -> None:
        """Refuse speeds that no mission has.

        Raises:
            ValueError: a speed is negative, not finite, or too great.
        """
        for name, most in (("wind", MOST_WIND), ("deck_speed", MOST_DECK_SPEED)):
            speed = getattr(self, name)
            if speed is not None and not 0.0 <= speed <= most:  # NaN is refused, too
                raise ValueError(f"{name}: expected a speed from 0 to {most:g} m/s, got {speed!r}")


class Request(NamedTuple):
    """A mission that is asked for."""

    field: str
    """``indoor`` or ``outdoor``."""
    seed: int
    choices: Choices | None = None
    """Numbers that are fixed instead of drawn."""


def draw_case(name: str, seed: int, choices: Choices | None = None) -> Case:
    """The case of a field and a seed; the same seed gives the same case.

    Args:
        name: ``indoor`` or ``outdoor``.
        seed: a whole number from 0 to 2^63 - 1.
        choices: numbers that are fixed.

    Raises:
        ValueError: no such field, or no such seed.

    Example:
        >>> case = draw_case("indoor", 3)
        >>> case.goal.shape, case.field.name
        ((3,), 'indoor')
    """
    if name not in FIELDS:
        raise ValueError(f"name: expected {' or '.join(FIELDS)}, got {name!r}")
    if not is_whole(seed, 0) or seed > MOST_SEED:
        raise ValueError(f"seed: expected a whole number from 0 to {MOST_SEED}, got {seed!r}")
    field, choices = FIELDS[name], choices or Choices()
    keys = jax.random.split(jax.random.fold_in(jax.random.key(seed), sorted(FIELDS).index(name)), 6)
    scene = (indoor if field.walls else outdoor)(keys[0])
    world = _world(field, keys[1:4], choices)
    lidar = LiDAR(_directions(20_000), leaves=field.leaves)
    goal = _free_place(keys[4], scene, field)
    return Case(world, with_walls(scene, field) if field.walls else scene, lidar, goal, keys[5], field)


def _world(field: Field, keys: Any, choices: Choices) -> World:
    vehicle, air, motion = keys  # an array of three
    airframe = _varied(vehicle) if choices.vary else simulated_mav()
    suction, depth, speed, angle = jax.random.uniform(air, (4,))
    drawn = 1.5 + 1.4 * float(suction), 0.2 + 0.1 * float(depth)
    force, height = drawn if choices.vary else (2.2, 0.25)
    wind = field.wind * float(speed) if choices.wind is None else choices.wind
    course = 2.0 * np.pi * float(angle)
    world = World.of(
        airframe=airframe,
        air=Aerodynamics(suction=force, suction_height=height),
        wind=(wind * np.cos(course), wind * np.sin(course), 0.0),
        start=field.home,
    )
    rate, turn = jax.random.uniform(motion, (2,))
    deck_speed = float(rate) if choices.deck_speed is None else choices.deck_speed
    velocity = (deck_speed, 0.0, 0.0)
    yaw_rate = 0.2 * (2.0 * float(turn) - 1.0) * float(deck_speed > 0.0)
    # the carrier waits until the landing: ``sent_off`` sets the time
    never = Course(field.home, velocity, yaw_rate, departure=1e4, duration=6.0 / max(deck_speed, 0.25))
    return eqx.tree_at(lambda w: w.course, world, jax.tree.map(jnp.asarray, never))


def sent_off(world: World, time: Scalar | float) -> World:
    """The world whose carrier begins its motion at a time, s."""
    return eqx.tree_at(lambda w: w.course.departure, world, jnp.asarray(time, float))


def _varied(key: PRNGKeyArray) -> Airframe:
    """The vehicle with mass +-10 %, inertia +-15 % and thrust +-5 %, uniform."""
    airframe = simulated_mav()
    mass, *inertia, thrust = (np.asarray(jax.random.uniform(key, (5,))) * 2.0 - 1.0).tolist()
    body = airframe.body
    moments = jnp.diagonal(body.inertia) * (1.0 + 0.15 * jnp.array(inertia))
    # of a rigid body, no moment exceeds the sum of the others
    moments = moments.at[2].min(0.99 * (moments[0] + moments[1]))
    return eqx.tree_at(
        lambda a: (a.body.mass, a.body.inertia, a.body.thrust_map, a.body.torque_map),
        airframe,
        (
            body.mass * (1.0 + 0.1 * mass),
            jnp.diag(moments),
            body.thrust_map * (1.0 + 0.05 * thrust),
            body.torque_map * (1.0 + 0.05 * thrust),
        ),
    )


def with_walls(scene: Scene, field: Field) -> Scene:
    """The scene inside four walls and a ceiling."""
    size = np.array(field.size)
    middle, half = size / 2.0, size / 2.0 + _WALL
    centres, halves = [], []
    for axis, side in ((0, 0), (0, 1), (1, 0), (1, 1), (2, 1)):
        centre, thick = middle.copy(), half.copy()
        centre[axis] = side * size[axis] + (2 * side - 1) * _WALL
        thick[axis] = _WALL
        centres.append(centre)
        halves.append(thick)
    return Scene(
        jnp.concatenate([scene.centres, jnp.array(centres)]),
        jnp.concatenate([scene.halves, jnp.array(halves)]),
        scene.axes,
        scene.radii,
        scene.heights,
    )


def _directions(count: int) -> Float[Array, "rays 3"]:
    """Directions on a sphere by the golden angle, without caps of 20 degrees about the poles."""
    z = np.cos(np.radians(20.0)) * np.linspace(-1.0, 1.0, count)
    angle = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    radius = np.sqrt(1.0 - z**2)
    return jnp.asarray(np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1))


def _free_place(key: PRNGKeyArray, scene: Scene, field: Field) -> Vector3:
    """The first of many drawn places that is free."""
    low, high = (jnp.array(corner) for corner in field.goal)
    places = jax.random.uniform(key, (_TRIALS, 3), minval=low, maxval=high)
    distance = jax.vmap(scene.distance)(places)
    free = distance > _FREE
    return places[jnp.argmax(jnp.where(free, 1.0, jnp.minimum(distance, 0.9) * 0.1))]
