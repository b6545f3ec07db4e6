"""Rules on the values of a mission, each written once.

``rules`` works on NumPy arrays (before anything is compiled) and on traced arrays.
"""

import numpy as np

from jaxscp.landing.hover import can_hover
from jaxscp.landing.inertia import inertia_rule
from jaxscp.landing.mission import Mission
from jaxscp.landing.recovery import CLEARANCE, LIMIT_RECOVERY
from jaxscp.landing.rule import Rule, face_text, short

PADDED = 1.0  # offset of a row that only pads: 0 . p <= 1
ASTRAY = 2e-3  # m: a plan may end so far outside of a wall
UNIT_NORM = 1e-3  # by which a quaternion's norm may differ from one


def rules(s: Mission, xp):
    """Every requirement on values; ``xp`` is numpy or jax.numpy."""
    yield from _direction_rules(s, xp)
    s = s.with_unit_directions()  # depths and clearances below are metres
    yield from _vehicle_rules(s, xp)
    yield from _limit_rules(s, xp)
    yield from _corridor_rules(s, xp)
    yield from _deck_rules(s, xp)
    yield from _flight_limit_rules(s, xp)
    yield from _duration_rules(s, xp)
    yield from _zone_rules(s, xp)
    yield from _component_rules(s, xp)
    yield from _hull_rules(s)


def _hull_rules(s: Mission):
    """The hull is a ball, and obstacles are known as far as it reaches."""
    radius = s.airframe.radius
    yield Rule(radius >= 0.0, f"airframe.radius: must not be negative, got {radius} m.")
    if s.near_obstacles is not None:
        spread = s.near_obstacles.spread
        yield Rule(spread >= 0.0, f"near_obstacles.spread: must not be negative, got {spread} m.")
        yield Rule(
            s.near_obstacles.reach >= s.airframe.radius,
            f"near_obstacles.reach: obstacles are known up to {s.near_obstacles.reach} m from the corridor, less than "
            f"airframe.radius, {s.airframe.radius} m. Make corridor and obstacles with this radius or a greater one.",
        )


def _direction_rules(s: Mission, xp):
    """Directions of any length are scaled. A length of zero, or a quaternion far from unit norm, is a mistake."""
    for name in ("start", "goal"):
        norm = xp.sqrt(xp.sum(getattr(s, name).attitude ** 2))
        yield Rule(
            xp.abs(norm - 1.0) <= UNIT_NORM,
            f"{name}.attitude: quaternion has norm {norm}, not 1. Is w first? Normalise it: q / np.linalg.norm(q).",
        )
    # Squares, as in the scaling: a normal whose square is zero has no direction.
    lost = (xp.sum(s.corridor.normals**2, axis=-1) == 0.0) & (s.corridor.offsets != PADDED)
    where = (
        f" face {np.argwhere(lost)[0][1]} of polytope {np.argwhere(lost)[0][0]}"
        if xp is np and lost.any()
        else ""
    )
    yield Rule(
        ~xp.any(lost),
        f"corridor.normals:{where} has a normal of length zero, and an offset that is not 1: its direction is lost. "
        "Only rows 0 . p <= 1 pad a polytope.",
    )


def _vehicle_rules(s: Mission, xp):
    body, frame = s.airframe.body, s.airframe
    yield Rule(body.mass > 0, f"airframe.body.mass: must be positive, got {body.mass} kg.")
    asymmetry = xp.max(xp.abs(body.inertia - xp.swapaxes(body.inertia, -1, -2)))
    definite = _positive_definite(0.5 * (body.inertia + xp.swapaxes(body.inertia, -1, -2)))
    yield Rule(
        definite & (asymmetry <= 1e-9 * xp.max(xp.abs(body.inertia))),
        "airframe.body.inertia: must be symmetric and positive definite; units are kg m^2.",
    )
    yield inertia_rule(frame, xp)
    excess = xp.max(frame.thrust_min - frame.thrust_max, initial=-np.inf)
    yield Rule(
        excess <= 0.0, f"airframe.thrust_min: exceeds airframe.thrust_max by {excess} N for some rotor."
    )
    down = body.gravity[2] <= 0.0
    yield Rule(
        down, f"airframe.body.gravity: gravity must point along -z, as z points up; got {body.gravity} m/s^2."
    )
    # Necessary: the greatest thrust along the body's z axis carries the weight.
    along = body.thrust_map[2]
    greatest = xp.sum(xp.maximum(along * frame.thrust_min, along * frame.thrust_max))
    least = xp.sum(xp.minimum(along * frame.thrust_min, along * frame.thrust_max))
    weight = -body.mass * body.gravity[2]
    enough, little = (greatest >= weight) | ~down, (least <= weight) | ~down
    yield Rule(
        enough,
        f"airframe: the rotors cannot carry the weight (greatest thrust {greatest} N, weight {weight} N): check "
        "airframe.body.mass in kg and airframe.thrust_max in N a rotor; hover is impossible.",
    )
    yield Rule(
        little,
        f"airframe.thrust_min: even the least thrust {least} N exceeds the weight {weight} N; hover is impossible.",
    )
    yield Rule(
        can_hover(frame, xp) | ~(down & enough & little) | (excess > 0.0),
        f"airframe: no thrusts between airframe.thrust_min and airframe.thrust_max carry the weight {weight} N without "
        "torque; hover is impossible. Does a rotor give no thrust, or has airframe.body.torque_map a wrong sign?",
    )


def _limit_rules(s: Mission, xp):
    yield Rule(
        (s.dilation_min > 0) & (s.dilation_min < s.dilation_max),
        f"dilation_min: need 0 < dilation_min < dilation_max, got {s.dilation_min} and {s.dilation_max} s.",
    )
    yield Rule(
        (s.cone_angle > 0) & (s.cone_angle < np.pi / 2),
        f"cone_angle: must lie between 0 and pi/2 radians, got {s.cone_angle}. Was it given in degrees?",
    )
    yield Rule(
        (s.weights.control >= 0) & (s.weights.time >= 0) & (s.weights.control + s.weights.time > 0),
        "weights: control and time must not be negative, and one must be positive.",
    )


def _corridor_rules(s: Mission, xp):
    corridor = s.corridor
    inside_first = xp.min(corridor.offsets[0] - corridor.normals[0] @ s.start.position)
    inside_last = xp.min(corridor.offsets[-1] - corridor.normals[-1] @ s.goal.position)
    recovery = short(s.recovery)
    allowed = "" if recovery == "0" else f"; of a measured start, recovery allows {recovery} m"
    yield Rule(s.recovery >= 0.0, f"recovery: must not be negative, got {s.recovery} m.")
    yield Rule(
        inside_first >= -CLEARANCE - s.recovery,
        f"start.position: lies {short(-inside_first)} m outside the corridor's first polytope, "
        f"{face_text(corridor, 0, s.start.position)}{allowed}.",
    )
    yield Rule(
        inside_last >= -CLEARANCE,
        f"goal.position: lies {short(-inside_last)} m outside the corridor's last polytope, "
        f"{face_text(corridor, -1, s.goal.position)}.",
    )
    for side, first in (("before", 0), ("after", 1)):
        normals, offsets = (
            corridor.normals[first:][: corridor.count - 1],
            corridor.offsets[first:][: corridor.count - 1],
        )
        depth = xp.min(offsets - xp.einsum("kfc,kc->kf", normals, corridor.joints), axis=-1, initial=np.inf)
        at_start = xp.all(corridor.joints == s.start.position, axis=-1)  # which has a rule of its own
        depth = xp.where(at_start, 0.0, depth)
        yield Rule(
            xp.all(depth >= -CLEARANCE),
            f"corridor.joints: a joint lies outside the polytope {side} it; those polytopes are disjoint or empty, "
            "or joints and polytopes are in different orders.",
        )
    yield Rule(
        xp.all(_bounded(corridor.normals, xp)),
        "corridor.normals: a polytope is unbounded; add faces (jaxscp.corridor.box makes a bounded one).",
    )


def _deck_rules(s: Mission, xp):
    """The deck is still in the last polytope at the least flight time; later, one that left it is farther outside."""
    if s.deck_velocity is None or s.goal_fixed is not None:
        return
    landing = s.goal.position + s.deck_velocity * s.dilation_min
    outside = xp.max(s.corridor.normals[-1] @ landing - s.corridor.offsets[-1])
    yield Rule(
        outside <= ASTRAY,
        f"deck_velocity: after the least flight time, dilation_min = {short(s.dilation_min)} s, the deck is "
        f"{short(outside)} m outside the corridor's last polytope. Is it in m/s?",
    )


def _bounded(normals, xp):
    """Whether {d : normals d <= 0} holds only zero, for each polytope.

    A larger cone contains a line or an extreme ray. With a line, the normals have rank below three. An extreme ray
    lies on two faces, and so along the cross product of their normals.
    """
    a, b = np.triu_indices(normals.shape[1], 1)
    rays = xp.cross(normals[:, a], normals[:, b])
    length = xp.sqrt(xp.sum(rays**2, axis=-1, keepdims=True))
    proper = length[..., 0] > 1e-9
    rays = rays / xp.maximum(length, 1e-9)
    along = xp.einsum("kfc,krc->krf", normals, rays)
    open_ray = (xp.max(along, axis=-1) <= 1e-9) | (xp.min(along, axis=-1) >= -1e-9)
    full_rank = _positive_definite(xp.einsum("kfc,kfd->kcd", normals, normals) - 1e-9 * np.eye(3))
    return full_rank & ~xp.any(open_ray & proper, axis=-1)


def _positive_definite(matrices):
    """Whether symmetric 3 x 3 matrices are, by Sylvester's criterion: all leading minors are positive."""
    (a, b, c), (_, d, e), (_, _, f) = ([matrices[..., i, j] for j in range(3)] for i in range(3))
    minor = a * d - b * b
    whole = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
    return (a > 0) & (minor > 0) & (whole > 0)


def _flight_limit_rules(s: Mission, xp):
    """Limits are positive, and both ends within them as far as they are fixed."""
    sizes = {"speed": ("velocity", "m/s"), "body_rate": ("body_rate", "rad/s")}
    for name in ("speed", "tilt", "body_rate", "thrust_rate"):
        limit = getattr(s.limits, name)
        if limit is None:
            continue
        yield Rule(limit > 0, f"limits.{name}: must be positive, got {limit}.")
        for end, fixed in (("start", s.start_fixed), ("goal", s.goal_fixed)):
            if name not in sizes or fixed is not None:
                continue
            part, unit = sizes[name]
            size = xp.sqrt(xp.sum(getattr(getattr(s, end), part) ** 2))
            yield Rule(
                size <= limit * _beyond_limits(s, end, xp),
                f"{end}.{part}: {size} {unit} is beyond limits.{name}, {limit} {unit}.",
            )
    if s.limits.tilt is not None:
        yield Rule(
            s.limits.tilt < np.pi, f"limits.tilt: must be below pi radians, got {s.limits.tilt}; in degrees?"
        )
        for end, fixed in (("start", s.start_fixed), ("goal", s.goal_fixed)):
            across = xp.sum(getattr(s, end).attitude[1:3] ** 2)
            inside = across <= xp.sin(0.5 * s.limits.tilt * _beyond_limits(s, end, xp)) ** 2 + CLEARANCE
            yield Rule(inside | (fixed is not None), f"{end}.attitude: tilted by more than limits.tilt.")


def _duration_rules(s: Mission, xp):
    """The greatest speed leads from start to goal within the greatest flight time."""
    if s.limits.speed is None or any(v is not None for v in (s.deck_velocity, s.start_fixed, s.goal_fixed)):
        return
    way = xp.sqrt(xp.sum((s.goal.position - s.start.position) ** 2))
    yield Rule(
        (way <= s.limits.speed * _beyond_limits(s, "start", xp) * s.dilation_max) | (s.limits.speed <= 0.0),
        f"dilation_max: at limits.speed, {s.limits.speed} m/s, the {short(way)} m from start to goal take longer than "
        f"the greatest flight time, {s.dilation_max} s; raise dilation_max.",
    )


def _beyond_limits(s: Mission, end: str, xp):
    """Factor on limits: a start that is measured may exceed them."""
    return xp.where(s.recovery > 0.0, 1.0 + LIMIT_RECOVERY, 1.0) if end == "start" else 1.0


def _depths(away, shapes, xp):
    """Depth of a point in each zone in m, exact for balls; negative outside."""
    least = 1.0 / xp.sqrt(xp.max(xp.sum(shapes**2, axis=2), axis=1))
    return (1.0 - xp.sqrt(xp.sum(away**2, axis=-1))) * least


def _zone_rules(s: Mission, xp):
    for name in ("keep_out", "gates"):
        zones = getattr(s, name)
        if zones is not None:
            yield Rule(
                xp.all(xp.abs(xp.linalg.det(zones.shapes)) > 0),
                f"{name}.shapes: a matrix is singular; semi-axes must be finite (jaxscp.ellipsoids makes them).",
            )
    if s.keep_out is not None:
        for end, fixed in (("start", s.start_fixed), ("goal", s.goal_fixed)):
            away = xp.einsum("zrc,zc->zr", s.keep_out.shapes, getattr(s, end).position - s.keep_out.centres)
            depth = _depths(away, s.keep_out.shapes, xp)
            outside = xp.all(depth <= (s.recovery if end == "start" else 0.0))
            yield Rule(outside | (fixed is not None), f"{end}.position: lies inside a zone of keep_out.")
    if s.gates is not None:
        passed = xp.all(s.gates.centres == s.start.position, axis=-1)
        heights = xp.einsum("kfc,gc->gkf", s.corridor.normals, s.gates.centres) - s.corridor.offsets
        yield Rule(
            xp.all(xp.any(xp.all(heights <= CLEARANCE, axis=-1), axis=-1) | passed),
            "gates.centres: a gate's centre lies outside every polytope of the corridor.",
        )


def _component_rules(s: Mission, xp):
    for name in ("start_fixed", "goal_fixed"):
        parts = getattr(s, name)
        if parts is not None:
            for part in ("position", "velocity", "attitude", "body_rate"):
                value = getattr(parts, part)
                yield Rule(
                    xp.all((value == 0) | (value == 1)),
                    f"{name}.{part}: each component is one (fixed) or zero (free), got {value}.",
                )
