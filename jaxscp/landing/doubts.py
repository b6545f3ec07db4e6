"""Doubts about the vehicle's size in its corridor: no contradiction, but likely a mistake."""

import jax
import numpy as np
from jaxtyping import Float

from jaxscp.core.arrays import namespace
from jaxscp.corridor.clouds import PointCloud
from jaxscp.corridor.obstacles import inside_corridor
from jaxscp.corridor.polytope import Polytope
from jaxscp.corridor.shapes import inscribed_radius
from jaxscp.landing.mission import Mission

_ON_FACE = 1e-6  # m: a point so near to a face lies on it, and not inside


def doubts(mission: Mission) -> tuple[str, ...]:
    """Texts for people, each with the field and the remedy; none of a mission that is traced.

    Example:
        >>> import jaxscp, warnings
        >>> ends = jaxscp.at_rest([1.0, 0.0, 1.0]), jaxscp.at_rest([5.0, 0.0, 1.0])
        >>> tube = jaxscp.corridor.connect([jaxscp.corridor.box([0.0, -0.05, 0.0], [6.0, 0.05, 2.0])])
        >>> with warnings.catch_warnings(action="ignore"):
        ...     narrow = jaxscp.scenarios.through(tube, *ends)
        >>> doubts(narrow)[0][:62]
        'corridor: polytope 0 leaves the centre a ball of radius 0.05 m'
    """
    values = mission.corridor, mission.obstacles, mission.near_obstacles, mission.airframe.radius
    if namespace(values) is not np or any(
        isinstance(v, jax.ShapeDtypeStruct) for v in jax.tree.leaves(values)
    ):
        return ()
    return tuple(text for text in (_points_inside(mission), _narrow(mission)) if text)


def _points_inside(mission: Mission) -> str:
    """Obstacle points in the corridor; of the known ones, or of those for pictures."""
    known = mission.near_obstacles
    if known is not None:
        points = np.asarray(known.points)[np.asarray(known.present & ~known.deck)]
    elif mission.obstacles is not None:
        points = np.asarray(mission.obstacles)
    else:
        return ""
    inside = inside_corridor(mission.corridor, PointCloud(points), -_ON_FACE)
    if not inside.any():
        return ""
    x, y, z = points[np.argmax(inside)]
    text = f"{inside.sum()} points lie inside the corridor, one at ({x:.3g}, {y:.3g}, {z:.3g}) m"
    if known is not None:
        return f"near_obstacles: {text}: a plan whose hull touches one is not converged; move the corridor's faces off"
    return (
        f"obstacles: {text}, and the vehicle may fly through them. Give through(..., near_obstacles=corridor."
        "obstacles_near(corridor, points, radius)), so that such a plan is not converged, or use build_corridor"
    )


def _narrow(mission: Mission) -> str:
    """A polytope in which no ball of the vehicle's radius fits, where no obstacle is known, and no margin was taken."""
    radius = float(mission.airframe.radius)
    margin = mission.corridor.margin
    if mission.near_obstacles is not None or (margin is not None and float(margin) >= radius):
        return ""
    places = _places(mission)
    for number, cell in enumerate(mission.corridor.distinct()):
        if _depth(cell, places) >= radius:  # the exact width needs a linear program, and SciPy's import
            continue
        widest = inscribed_radius(cell)
        if widest < radius:
            return (
                f"corridor: polytope {number} leaves the centre a ball of radius {widest:.3g} m, less than "
                f"airframe.radius, {radius:.3g} m. A corridor bounds the centre: if its faces are walls, use "
                f"connect(..., margin={radius:.3g}); if they keep that distance, give near_obstacles"
            )
    return ""


def _places(mission: Mission) -> Float[np.ndarray, "points 3"]:
    """Start, joints and goal, and the middles between them, m."""
    ends = [np.asarray(end.position)[None] for end in (mission.start, mission.goal)]
    points = np.concatenate([ends[0], np.asarray(mission.corridor.joints), ends[1]])
    return np.concatenate([points, 0.5 * (points[1:] + points[:-1])])


def _depth(cell: Polytope, places: Float[np.ndarray, "points 3"]) -> float:
    """Distance to the nearest face from the one of some places that lies deepest in a polytope, m."""
    normals, offsets = np.asarray(cell.normals), np.asarray(cell.offsets)
    sizes = np.maximum(np.linalg.norm(normals, axis=1), np.finfo(float).tiny)
    return float(np.max(np.min((offsets - places @ normals.T) / sizes, axis=1)))
