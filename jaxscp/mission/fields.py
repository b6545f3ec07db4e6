"""Kinds of places that missions fly in."""

import dataclasses

MOST_SEED = 2**63 - 1
"""Greatest seed of a mission: a key of JAX takes 64 bits with a sign."""
MOST_WIND = 15.0
"""Greatest mean wind of a mission, m/s."""
MOST_DECK_SPEED = 1.0
"""Greatest speed of the deck in a landing, m/s."""


@dataclasses.dataclass(frozen=True)
class Field:
    """A kind of place: its size, its limits for the vehicle's centre, its sensors and speeds."""

    name: str
    size: tuple[float, float, float]
    """m; the flight goes from low y to high y."""
    lower: tuple[float, float, float]
    """Least coordinates of the vehicle's centre in a plan, m."""
    upper: tuple[float, float, float]
    """Greatest coordinates, m."""
    home: tuple[float, float, float]
    """Where the carrier waits, m."""
    goal: tuple[tuple[float, float, float], tuple[float, float, float]]
    """Lowest and highest corner of the goals, m."""
    speed: float
    """Greatest speed of a plan, m/s."""
    radii: tuple[float, ...]
    """Distances from obstacles that a corridor tries to keep, the widest first, m."""
    wind: float
    """Greatest mean wind, m/s."""
    leaves: float
    """Returns of leaves for each metre of a ray's way."""
    walls: bool


INDOOR = Field(
    name="indoor",
    size=(10.0, 20.0, 6.0),
    lower=(0.5, 0.5, 0.6),
    upper=(9.5, 19.5, 5.4),
    home=(1.5, 2.0, 2.0),
    goal=((2.0, 17.0, 1.0), (8.0, 18.5, 3.0)),
    speed=2.5,
    radii=(0.6, 0.5, 0.4, 0.32, 0.24),
    wind=0.0,
    leaves=0.0,
    walls=True,
)
OUTDOOR = Field(
    name="outdoor",
    size=(50.0, 50.0, 8.0),
    lower=(-5.0, -5.0, 0.8),
    upper=(55.0, 55.0, 9.0),
    home=(20.0, 0.0, 2.0),
    goal=((15.0, 47.0, 1.5), (35.0, 49.0, 4.0)),
    speed=4.0,
    radii=(1.0, 0.8, 0.6, 0.45, 0.3),
    wind=8.0,
    leaves=0.002,
    walls=False,
)
FIELDS = {field.name: field for field in (INDOOR, OUTDOOR)}
