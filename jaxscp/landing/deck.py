"""A moving deck and the last polytope: when the deck leaves it, and whether a flight can land before."""

from collections.abc import Iterator

import numpy as np

from jaxscp.landing.mission import Mission
from jaxscp.problem.trajectory import Trajectory

_LEAST = 1e-9
_SAME_PLACE = 2e-3  # m: a plan ends so near to the deck


def leaving_time(mission: Mission) -> float:
    """Time in s at which the deck leaves the last polytope; infinite where it stays, or does not move.

    Args:
        mission: of known values.

    Example:
        >>> import dataclasses, jaxscp
        >>> scenario = jaxscp.scenarios.platform_to_platform()  # from x = 10 m to a wall at x = 11 m
        >>> leaving_time(dataclasses.replace(scenario, deck_velocity=[0.25, 0.0, 0.0]))
        4.0
    """
    if mission.deck_velocity is None or mission.goal_fixed is not None:
        return np.inf
    normals, offsets = np.asarray(mission.corridor.normals[-1]), np.asarray(mission.corridor.offsets[-1])
    outwards = normals @ np.asarray(mission.deck_velocity)
    depth = np.maximum(offsets - normals @ np.asarray(mission.goal.position), 0.0)
    moves = outwards > 0.0
    return float(np.min(depth[moves] / outwards[moves], initial=np.inf))


def least_flight_time(mission: Mission) -> float:
    """Time in s along the route at the greatest horizontal acceleration and speed, to rest at the goal.

    Example:
        >>> import jaxscp
        >>> 1.0 < least_flight_time(jaxscp.scenarios.platform_to_platform()) < 2.0
        True
    """
    ends = [np.asarray(end.position)[None] for end in (mission.start, mission.goal)]
    points = np.concatenate([ends[0], np.asarray(mission.corridor.joints), ends[1]])
    length = np.sum(np.linalg.norm(np.diff(points, axis=0), axis=1))
    body, limits = mission.airframe.body, mission.limits
    lift = np.asarray(body.thrust_map)[2] @ np.asarray(mission.airframe.thrust_max) / np.asarray(body.mass)
    gravity = np.linalg.norm(body.gravity)
    acceleration = np.sqrt(np.maximum(np.square(lift) - np.square(gravity), 0.0))  # level, at full thrust
    if limits.tilt is not None and float(limits.tilt) < 0.5 * np.pi:
        acceleration = np.minimum(acceleration, gravity * np.tan(np.asarray(limits.tilt)))
    acceleration = np.maximum(acceleration, _LEAST)
    limit = np.inf if limits.speed is None else np.asarray(limits.speed)
    first = np.minimum(np.linalg.norm(mission.start.velocity), limit)
    top = np.minimum(limit, np.sqrt(acceleration * length + 0.5 * np.square(first)))
    # m, to reach the top speed and to brake
    turning = (np.square(top) - 0.5 * np.square(first)) / acceleration
    cruising = np.maximum(length - turning, 0.0) / np.maximum(top, _LEAST)
    return float(np.maximum(2.0 * top - first, 0.0) / acceleration + cruising)


def deck_doubts(mission: Mission) -> Iterator[str]:
    """Text on a deck that leaves the last polytope before the vehicle can land; nothing if there is no doubt.

    Args:
        mission: of known values, with unit normals or without.

    Example:
        >>> import dataclasses, jaxscp
        >>> scenario = jaxscp.scenarios.platform_to_platform()
        >>> next(deck_doubts(dataclasses.replace(scenario, deck_velocity=[1.0, 0.0, 0.0])))[:74]
        "deck_velocity: the deck leaves the corridor's last polytope after 1 s, and"
    """
    leaves = leaving_time(mission)
    if leaves < np.inf and leaves < (least := least_flight_time(mission)):
        yield (
            f"deck_velocity: the deck leaves the corridor's last polytope after {leaves:.3g} s, and the flight takes "
            f"{least:.3g} s or more. The last polytope must contain the deck until the landing: make it longer"
        )


def deck_outside(mission: Mission, time: float) -> str:
    """Words on a deck that is outside of the last polytope at a time in s; empty if it is inside.

    Example:
        >>> import dataclasses, jaxscp
        >>> scenario = jaxscp.scenarios.platform_to_platform()
        >>> deck_outside(dataclasses.replace(scenario, deck_velocity=[0.25, 0.0, 0.0]), 5.0)
        'at 5 s the deck is 0.25 m outside the last polytope, which it leaves at 4 s'
    """
    if not (leaves := leaving_time(mission)) < time:
        return ""
    mission = mission.with_unit_directions()
    here = np.asarray(mission.goal.position) + np.asarray(mission.deck_velocity) * time
    outside = float(np.max(np.asarray(mission.corridor.normals[-1]) @ here - mission.corridor.offsets[-1]))
    return f"at {time:.3g} s the deck is {outside:.2g} m outside the last polytope, which it leaves at {leaves:.3g} s"


def goal_was_left(mission: Mission, plan: Trajectory, elapsed: float) -> str:
    """Doubt about a re-plan's goal that is where the deck was at the start of the plan; empty if there is none.

    The plan ends on the deck. So its own goal lies before its end by the deck's whole way.

    Args:
        mission: of known values; its time zero is now.
        plan: that began ``elapsed`` s ago.
        elapsed: s.

    Example:
        >>> import dataclasses, jax, jaxscp
        >>> jax.config.update("jax_enable_x64", True)
        >>> moving = dataclasses.replace(jaxscp.scenarios.platform_to_platform(), deck_velocity=[0.25, 0.0, 0.0])
        >>> landed = [0.0] * 13, [10.5, 0.0, 1.0, *[0.0] * 10]
        >>> plan = jaxscp.Trajectory.from_arrays([0.0, 2.0], landed, [[0.0] * 4] * 2)
        >>> goal_was_left(moving, plan, 1.0)[:50], goal_was_left(moving.after(1.0), plan, 1.0)
        ('goal.position: the deck is where it was when the p', '')
    """
    if mission.deck_velocity is None or mission.goal_fixed is not None:
        return ""
    velocity, last = np.asarray(mission.deck_velocity), np.asarray(plan.state)[-1, :3]
    way = float(np.linalg.norm(velocity)) * elapsed
    beside = np.asarray(mission.goal.position) + velocity * float(plan.time[-1]) - last
    if way <= 2.0 * _SAME_PLACE or float(np.linalg.norm(beside)) > _SAME_PLACE:
        return ""
    return (
        f"goal.position: the deck is where it was when the plan began, {elapsed:.3g} s ago, though deck_velocity has "
        f"moved it by {way:.2g} m since. Give the present scenario: scenario.after(elapsed)"
    )
