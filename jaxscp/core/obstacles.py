"""Obstacle points, and a hull that must not touch them: data that corridors make and certificates judge."""

import equinox as eqx
from jaxtyping import Array, Bool, Float

from jaxscp.core.types import Scalar


class Obstacles(eqx.Module):
    """Obstacle points near a corridor, padded to a static size."""

    points: Float[Array, "points 3"]
    """Positions, (points, 3), metres; zero in rows that pad."""
    present: Bool[Array, "points"]
    """False in rows that pad, (points,)."""
    deck: Bool[Array, "points"]
    """Points of a deck, which count except in the first and the last leg, (points,)."""
    spread: Scalar
    """How far an original point can be from the one that stands for it, metres."""
    reach: Scalar
    """Distance from the corridor within which every obstacle is known, metres."""


class Hull(eqx.Module):
    """A vehicle as a ball, and the obstacles that it must not touch."""

    radius: Scalar
    """Of the ball about the vehicle's centre, metres."""
    obstacles: Obstacles
    at_deck: Bool[Array, "intervals"]
    """Intervals of the first and the last leg, where points of a deck do not count."""
