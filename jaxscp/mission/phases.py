"""Phases of a mission, as integers that a compiled program carries."""

from enum import IntEnum

import numpy as np


class Phase(IntEnum):
    """Phase of the vehicle."""

    on_deck = 0
    """Motors at their least thrust, before the start."""
    spool_up = 1
    """Thrust rises until the vehicle leaves the deck against its suction."""
    climb = 2
    """Upwards over the deck."""
    hover = 3
    """At a place, waiting for the planner."""
    cruise = 4
    """Along a plan."""
    approach = 5
    """To a place above the deck, at the deck's velocity."""
    land = 6
    """Down, inside the cone."""
    touch_down = 7
    """Contact is detected: motors to their least thrust."""
    landed = 8
    """At rest on the deck, motors off."""
    go_around = 9
    """Up again, away from the deck."""
    safe_hover = 10
    """The mission is given up: the vehicle holds its place."""
    level_off = 11
    """The last centimetres of a landing in wind: level, however the wind pushes."""


def phase_names(codes) -> list[str]:
    """Names of an array of codes.

    Example:
        >>> phase_names([0, 4, 8])
        ['on_deck', 'cruise', 'landed']
    """
    return [Phase(int(code)).name for code in np.ravel(codes)]
