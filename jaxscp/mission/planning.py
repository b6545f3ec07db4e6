"""From a map to a plan: corridor, scenario, trajectory. It runs on the host."""

import dataclasses
import warnings
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from jaxscp.core.status import status_names
from jaxscp.corridor import CorridorResult, PointCloud, build_corridor, pad
from jaxscp.dynamics.airframes import Airframe
from jaxscp.landing import scenarios
from jaxscp.landing.mission import Weights, at_rest, flight_limits
from jaxscp.landing.scenario import LandingScenario
from jaxscp.mission.fields import Field
from jaxscp.mission.mapping import clearance
from jaxscp.solver.planner import Planner

POLYTOPES, FACES = (8, 16), 40  # sizes that compile once each
THRUST_RESERVE = 0.75  # of the greatest thrust, for the plan
_TILT = 0.5  # rad
_LEAST = 0.6  # N a rotor: attitude control keeps some thrust
_VIRTUAL_SPACING = 0.15
_HALVINGS = 2  # of the way, where the whole one has no plan
_ROOM = 0.8  # m from obstacles, at which a plan can start
_RETREAT = 0.3  # m
_CARRIER = 0.6  # half width of the carrier as an obstacle, m
Place = Float[np.ndarray, "3"]


@dataclasses.dataclass(frozen=True)
class Planned:
    """A plan, or why there is none."""

    trajectory: Any
    """A ``Trajectory``, or None."""
    message: str
    corridor: CorridorResult | None = None
    radius: float = 0.0
    """Distance from obstacles that the corridor keeps, m."""


class MissionPlanner:
    """Plans a way from hover to hover through a cloud.

    Args:
        field: limits and speeds.
        airframe: the vehicle as it is known.
        planner: by default the paper's method on 30 nodes: it stops at the first feasible plan, in milliseconds.
    """

    def __init__(self, field: Field, airframe: Airframe, planner: Planner | None = None) -> None:
        self.field = field
        self.planner = planner or Planner.paper(nodes=30)
        limits = THRUST_RESERVE * airframe.thrust_max, np.full(len(airframe.thrust_max), _LEAST)
        self.airframe = dataclasses.replace(airframe, thrust_max=limits[0], thrust_min=limits[1])

    def plan(self, cloud: PointCloud, start: Place, goal: Place, deck: Place) -> Planned:
        """A plan at the widest distance that has one, else a plan of half of the way.

        Args:
            cloud: obstacles in the frame of the odometry.
            start: of the plan, at rest, m.
            goal: at rest, m.
            deck: centre of the deck's surface, m: the carrier is an obstacle.
        """
        obstacles = PointCloud.of(np.concatenate([cloud.points, carrier_points(deck)]))
        reasons = []
        for radius in self.field.radii:
            end = goal
            for _ in range(_HALVINGS + 1):
                found = self._corridor(obstacles, start, end, radius)
                if isinstance(found, str):
                    reasons.append(f"{radius:.2f} m: {found}")
                    break
                solution = self.planner(self.scenario(found, start, end))
                status = status_names(solution.status)
                if status == "converged":
                    return Planned(solution.trajectory, "converged", found, radius)
                reasons.append(f"{radius:.2f} m: {status}")
                end = half_way(found.route)
        return Planned(None, "; ".join(reasons))

    def _corridor(self, cloud: PointCloud, start: Place, goal: Place, radius: float) -> CorridorResult | str:
        """A padded corridor, or the reason why there is none."""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                found = build_corridor(
                    cloud,
                    start,
                    goal,
                    radius,
                    lower=np.minimum(self.field.lower, np.minimum(start, goal) - 0.1),
                    upper=np.maximum(self.field.upper, np.maximum(start, goal) + 0.1),
                )
            return _padded(found, goal) if found.found else found.message
        except ValueError as error:
            return str(error)

    def scenario(self, found: CorridorResult, start: Place, goal: Place) -> LandingScenario:
        """The scenario of a corridor, with the limits of the field."""
        assert found.corridor is not None  # ``found`` says so
        return scenarios.through(
            jax.tree.map(jax.numpy.asarray, found.corridor),
            at_rest(start),
            at_rest(goal),
            airframe=self.airframe,
            limits=flight_limits(speed=self.field.speed, tilt=_TILT),
            weights=Weights(control=1.0, time=2.0),
        )


def _padded(found: CorridorResult, goal: Place) -> CorridorResult:
    """The same with its corridor at the least size that it fits in.

    Raises:
        ValueError: it has more polytopes or faces than any of these sizes.
    """
    assert found.corridor is not None  # ``found`` says so
    count = next((size for size in POLYTOPES if found.corridor.count <= size), POLYTOPES[-1])
    return eqx.tree_at(lambda f: f.corridor, found, pad(found.corridor, goal, count, FACES))


def half_way(route: Any) -> Place:
    """Point at half of the length of a route, m."""
    lengths = np.linalg.norm(np.diff(route.points, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    return np.array([np.interp(0.5 * along[-1], along, coordinate) for coordinate in route.points.T])


def carrier_points(deck: Place) -> Float[np.ndarray, "points 3"]:
    """The carrier as points: a plate of the deck's height."""
    steps = np.arange(-_CARRIER, _CARRIER + 1e-9, _VIRTUAL_SPACING)
    x, y = np.meshgrid(steps, steps, indexing="ij")
    plate = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    return deck + np.concatenate([plate, plate - [0.0, 0.0, _VIRTUAL_SPACING]])


def retreat(points: Float[np.ndarray, "points 3"], here: Place) -> Place | None:
    """A place a little farther from the points that are close, or None where none is close or none is farther.

    Example:
        >>> retreat(np.array([[0.5, 0.0, 0.0]]), np.zeros(3)).round(3).tolist()
        [-0.3, 0.0, 0.0]
        >>> retreat(np.array([[2.0, 0.0, 0.0]]), np.zeros(3)) is None
        True
    """
    away = here - points
    distance = np.linalg.norm(away, axis=1)
    close = distance < _ROOM
    if not close.any():
        return None
    push = np.sum(away[close] / distance[close, None] ** 3, axis=0)  # the nearest points count most
    place = here + _RETREAT * push / max(float(np.linalg.norm(push)), 1e-9)
    farther = clearance(points, place[None]) > distance.min()
    return place if farther else None
