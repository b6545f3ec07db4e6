"""The assessment of a flight, by the truth and the true obstacles."""

import dataclasses

import numpy as np
from jaxtyping import Float

from jaxscp.mission.attitudes import rotations
from jaxscp.mission.member import Record
from jaxscp.mission.phases import Phase
from jaxscp.simulation.bodies import DECK_HEIGHT, FEET, FOOT
from jaxscp.simulation.simulate import TICK
from jaxscp.simulation.vehicles import FEET_DEPTH

Turns = Float[np.ndarray, "ticks 3 3"]

HULL = 0.115  # m: half the diagonal and a rotor's radius
_AWAY = 0.5  # m over the deck: after that a contact is a landing
_CONTACT = 0.0005  # m
_ON_DECK = 0.3  # m from the deck's centre
_CARRIER = 0.65  # m, radius of the carrier


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What happened in truth; numbers of the touch-down are NaN where there was none."""

    landed: bool
    """At rest on the deck at the end, motors off, without a collision."""
    goal_distance: float
    """Least distance of the true vehicle from the task's goal, m: the drift at least."""
    collision: bool
    """The hull met an obstacle, the ground or the carrier."""
    attempts: int
    """Approaches."""
    end: str
    """Last phase."""
    touchdown: float
    """Distance of the first contact from the deck's centre, m."""
    vertical_speed: float
    """Relative to the deck just before the first contact, m/s."""
    tilt: float
    """Between the axes of vehicle and deck at the first contact, degrees."""
    least_distance: float
    """Of the vehicle's centre from the obstacles, m."""
    drift: float
    """Greatest error of the estimated position, m."""
    duration: float
    """s"""
    where: tuple[float, float]
    """Of the first contact on the deck, in its axes, m."""


def assess(record: Record, attempts: int, goal: Float[np.ndarray, "3"]) -> Outcome:
    """The outcome of a flight from its record, its number of approaches and its true goal, m."""
    flight, distance = record.flight(), record.distance()
    vehicle, carrier = np.asarray(flight.vehicle), np.asarray(flight.carrier)
    own, turn = (rotations(body[:, 6:10]).as_matrix() for body in (vehicle, carrier))
    relative, speed, tilt = _relative(vehicle - carrier, own, turn)
    height = relative[:, 2] - DECK_HEIGHT - FEET_DEPTH
    away = np.argmax(height > _AWAY) if (height > _AWAY).any() else len(height)
    low = _lowest_foot(vehicle - carrier, own, turn) < _CONTACT
    contact = np.flatnonzero((np.arange(len(height)) > away) & low & _over(relative))
    hit = bool(distance.min() < HULL) or bool(_carrier_hit(relative, height))
    on_deck = abs(height[-1]) < 0.02 and np.hypot(*relative[-1, :2]) < _ON_DECK
    landed = record.phases[-1] == Phase.landed and on_deck and not hit
    nan = float("nan")
    numbers = [nan, nan, nan, (nan, nan)]
    if len(contact):
        first = int(contact[0])
        place = relative[first, :2]
        before = max(first - 2, 0)
        numbers = [
            float(np.hypot(*place)),
            float(-speed[before, 2]),
            float(tilt[first]),
            tuple(place.tolist()),
        ]
    return Outcome(
        landed=bool(landed),
        goal_distance=float(np.linalg.norm(vehicle[:, :3] - goal, axis=1).min()),
        collision=hit,
        attempts=attempts,
        end=record.phases[-1].name,
        touchdown=numbers[0],
        vertical_speed=numbers[1],
        tilt=numbers[2],
        least_distance=float(distance.min()),
        drift=float(np.linalg.norm((flight.vehicle - flight.estimate)[:, :3], axis=1).max()),
        duration=len(height) * TICK,
        where=numbers[3],
    )


def _lowest_foot(difference: np.ndarray, own: Turns, turn: Turns) -> np.ndarray:
    """Height of the lowest point of the four feet over the deck, m; arguments as of ``_relative``."""
    centre = difference[:, None, :3] + np.einsum("tij,fj->tfi", own, FEET)
    up = np.einsum("tfi,ti->tf", centre, turn[:, :, 2])
    return up.min(axis=1) - FOOT - DECK_HEIGHT


def _over(relative: Float[np.ndarray, "ticks 3"]) -> np.ndarray:
    return np.hypot(relative[:, 0], relative[:, 1]) < 0.5


def _carrier_hit(relative: Float[np.ndarray, "ticks 3"], height: np.ndarray) -> bool:
    """Whether the vehicle came under the deck's surface within the carrier's radius."""
    inside = np.hypot(relative[:, 0], relative[:, 1]) < _CARRIER
    return bool((inside & (height < -0.03) & (height > -0.4)).any())


def _relative(difference: np.ndarray, own: Turns, turn: Turns) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position and velocity of the vehicle in the carrier's axes, m and m/s, and the angle of their z axes, degrees.

    Args:
        difference: of the vehicle's states from the carrier's.
        own: the vehicle's axes.
        turn: the carrier's.
    """
    position = np.einsum("tji,tj->ti", turn, difference[:, :3])
    velocity = np.einsum("tji,tj->ti", turn, difference[:, 3:6])
    cosine = np.sum(turn[:, :, 2] * own[:, :, 2], axis=1)
    return position, velocity, np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
