"""The two missions of the paper, rebuilt: obstacles as point clouds, corridors as stored boxes.

The paper gives neither its clouds nor its corridors; sizes here follow its text (a flight of about 10 m among
obstacles, and one up to a high platform).
"""

import warnings
from typing import Any, TypedDict, Unpack

import numpy as np

from jaxscp.core.arrays import floats
from jaxscp.core.obstacles import Obstacles
from jaxscp.corridor.polytopes import Corridor, box, connect
from jaxscp.dynamics.airframes import Airframe, paper_mav
from jaxscp.landing.doubts import doubts
from jaxscp.landing.mission import BodyState, Components, Ellipsoids, FlightLimits, Weights, at_rest
from jaxscp.landing.scenario import LandingScenario
from jaxscp.landing.structure import check_parts

_SPACING = 0.15  # m between obstacle points


def platform_to_platform() -> LandingScenario:
    """Case 1: from one platform to another 10 m away, through the gaps of two walls.

    Walls of 40 cm leave a gap on the right, then one on the left; the corridor keeps 25 cm from them.
    """
    walls = [([3.0, -0.8, 0.0], [3.4, 4.0, 3.3]), ([6.6, -3.5, 0.0], [7.0, 1.2, 3.3])]
    platforms = [([-0.5, 0.0, 0.0], [0.5, 1.0, 0.9]), ([9.5, -0.5, 0.0], [10.5, 0.5, 0.9])]
    corridor = connect(
        [
            box([-1.0, -3.0, 0.9], [2.75, 3.0, 3.0]),
            box([1.5, -3.0, 0.9], [5.0, -1.05, 3.0]),
            box([3.65, -3.0, 0.9], [6.35, 3.5, 3.0]),
            box([5.0, 1.45, 0.9], [8.6, 3.5, 3.0]),
            box([7.25, -3.0, 0.9], [11.0, 3.5, 3.0]),
        ],
        joints=[[2.1, -1.5, 1.5], [4.3, -1.6, 1.6], [5.7, 2.0, 1.6], [7.9, 2.0, 1.6]],
    )
    return _mission(at_rest([0.0, 0.5, 1.0]), at_rest([10.0, 0.0, 1.0]), corridor, walls + platforms)


def ascent_to_platform() -> LandingScenario:
    """Case 2: out from under a mezzanine, up beside it, and down onto a platform 4.7 m high."""
    obstacles = [
        ([-1.5, -1.5, 2.9], [0.5, 4.5, 3.1]),  # mezzanine
        ([4.2, 2.2, 0.0], [5.8, 3.8, 4.6]),  # tower that carries the platform
        ([-0.5, -0.5, 0.0], [0.5, 0.5, 0.9]),  # take-off platform
    ]
    corridor = connect(
        [
            box([-1.0, -1.2, 0.9], [3.0, 4.2, 2.6]),
            box([0.8, 1.2, 0.9], [3.0, 4.2, 6.5]),
            box([0.8, 1.2, 4.7], [7.0, 4.2, 6.5]),
        ],
        joints=[[1.8, 2.4, 1.9], [1.9, 2.7, 5.5]],
    )
    return _mission(at_rest([0.0, 0.0, 1.0]), at_rest([5.0, 3.0, 4.7]), corridor, obstacles)


def usual_airframe() -> Airframe:
    """The vehicle of a scenario that names none: the paper's."""
    return paper_mav()


class Parts(TypedDict, total=False):
    """Keyword arguments of ``through``: the fields of ``LandingScenario``."""

    airframe: Airframe
    cone_angle: Any
    weights: Weights
    dilation_min: Any
    dilation_max: Any
    limits: FlightLimits
    keep_out: Ellipsoids | None
    gates: Ellipsoids | None
    deck_velocity: Any
    start_fixed: Components | None
    goal_fixed: Components | None
    recovery: Any
    near_obstacles: Obstacles | None


def through(
    corridor: Corridor, start: BodyState, goal: BodyState, obstacles: Any = None, **parts: Unpack[Parts]
) -> LandingScenario:
    """A flight through a corridor of one's own, with the paper's vehicle, cone and weights unless others are given.

    Args:
        corridor: from ``jaxscp.corridor.build_corridor``, or by hand.
        start: where the flight begins, ``jaxscp.at_rest(position, yaw)`` say.
        goal: where it lands.
        obstacles: (points, 3) in m, for pictures.
        parts: other fields of ``LandingScenario``: airframe, weights, limits, keep_out, gates, deck_velocity,
            cone_angle, dilation_min, dilation_max, start_fixed, goal_fixed, recovery, near_obstacles.

    Warns of obstacle points inside the corridor. Where no near obstacle is known, also warns of a polytope in which no
    ball of the vehicle's radius fits: a corridor bounds the vehicle's centre.

    Raises:
        TypeError: a scenario has no such field; the message lists them.
        InvalidScenario: a part is of another class, a list instead of a state, say.

    Example:
        >>> import jaxscp
        >>> room = jaxscp.corridor.box([0.0, 0.0, 0.0], [6.0, 4.0, 3.0])
        >>> corridor = jaxscp.corridor.connect([room], joints=[])
        >>> ends = jaxscp.at_rest([1.0, 2.0, 1.0]), jaxscp.at_rest([5.0, 2.0, 1.0])
        >>> float(jaxscp.scenarios.through(corridor, *ends).airframe.body.mass)
        0.928
        >>> limits = jaxscp.flight_limits(speed=2.0)
        >>> float(jaxscp.scenarios.through(corridor, *ends, limits=limits).limits.speed)
        2.0
    """
    if unknown := sorted(set(parts) - set(Parts.__annotations__)):
        raise TypeError(
            f"through: unknown {', '.join(unknown)}; there are {', '.join(sorted(Parts.__annotations__))}"
        )
    scenario = _through(corridor, start, goal, obstacles, **parts)
    check_parts(scenario)
    for doubt in doubts(scenario):
        warnings.warn(doubt, stacklevel=2)
    return scenario


def _through(
    corridor: Corridor, start: BodyState, goal: BodyState, obstacles: Any, **parts: Unpack[Parts]
) -> LandingScenario:
    paper: Parts = {
        "airframe": usual_airframe(),
        "cone_angle": np.pi / 4,
        "weights": Weights(control=1.0, time=0.0),
        "dilation_min": 0.5,
        "dilation_max": 20.0,
    }
    return LandingScenario(start=start, goal=goal, corridor=corridor, obstacles=obstacles, **(paper | parts))


def _mission(start: BodyState, goal: BodyState, corridor: Corridor, obstacles) -> LandingScenario:
    """A stored case; a test finds no doubt in it, and a new process need not look for one."""
    surfaces = [_surface(*map(np.asarray, corners)) for corners in obstacles]
    return _through(corridor, start, goal, floats(np.concatenate(surfaces)))


def _surface(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Points on the six sides of a box, on a regular grid."""
    counts = np.maximum(np.ceil((upper - lower) / _SPACING).astype(int) + 1, 2)
    axes = [np.linspace(a, b, n) for a, b, n in zip(lower, upper, counts, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    on_side = np.any((grid == lower) | (grid == upper), axis=1)
    return grid[on_side]
