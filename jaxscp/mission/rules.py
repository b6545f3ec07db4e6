"""Numbers that the mission decides by."""

import equinox as eqx

from jaxscp.core.arrays import as_floats
from jaxscp.core.types import Scalar


class Rules(eqx.Module):
    """Heights, speeds and limits of the mission's phases. Heights are of the feet over the deck's surface."""

    start_height: Scalar = eqx.field(converter=as_floats, default=1.0)
    """Height of the first climb, m. 0.5 m may fail against suction, see ``docs/mission.md``."""
    approach_height: Scalar = eqx.field(converter=as_floats, default=1.0)
    """Height at which the vehicle waits over the deck before it lands, m."""
    return_height: Scalar = eqx.field(converter=as_floats, default=1.8)
    """Height over the deck at which a plan back ends, m: the deck's place is as uncertain there as the drift."""
    climb_speed: Scalar = eqx.field(converter=as_floats, default=1.0)
    """Speed of the target in a climb, m/s."""
    approach_speed: Scalar = eqx.field(converter=as_floats, default=1.5)
    """Speed of the target relative to the deck in an approach, m/s."""
    descent_gain: Scalar = eqx.field(converter=as_floats, default=0.8)
    """Descent speed for each metre of height, 1/s."""
    slowest_descent: Scalar = eqx.field(converter=as_floats, default=0.25)
    """m/s, down to the deck."""
    fastest_descent: Scalar = eqx.field(converter=as_floats, default=0.6)
    """m/s"""
    spool_rate: Scalar = eqx.field(converter=as_floats, default=4.0)
    """Rise of each rotor's thrust in spool-up, N/s."""
    lift_off: Scalar = eqx.field(converter=as_floats, default=0.04)
    """Height at which the vehicle has left the deck, m."""
    still: Scalar = eqx.field(converter=as_floats, default=0.3)
    """s for which a place must be held before the next phase."""
    place_error: Scalar = eqx.field(converter=as_floats, default=0.06)
    """Horizontal error at which the descent may begin, m."""
    speed_error: Scalar = eqx.field(converter=as_floats, default=0.15)
    """Speed relative to the target at which a place is reached, m/s."""
    cone_floor: Scalar = eqx.field(converter=as_floats, default=0.03)
    """Horizontal error on the deck up to which the descent goes on, m."""
    cone_slope: Scalar = eqx.field(converter=as_floats, default=0.3)
    """Further horizontal error for each metre of height."""
    calm: Scalar = eqx.field(converter=as_floats, default=0.3)
    """Horizontal disturbance in N below which a landing needs no levelling: hover is level to two degrees."""
    level_height: Scalar = eqx.field(converter=as_floats, default=0.07)
    """Height in m below which a vehicle that leans against the wind levels off."""
    level_descent: Scalar = eqx.field(converter=as_floats, default=0.35)
    """Speed of the descent meanwhile, m/s."""
    level_time: Scalar = eqx.field(converter=as_floats, default=0.6)
    """s after which a vehicle that levels off stands on the deck; or else it goes around."""
    level_drift: Scalar = eqx.field(converter=as_floats, default=0.007)
    """Way in m that the wind then pushes the vehicle, per m/s^2 of its push: a landing aims as far upwind."""
    greatest_error: Scalar = eqx.field(converter=as_floats, default=0.15)
    """Horizontal error beyond the cone at which the vehicle goes around, m."""
    touch_height: Scalar = eqx.field(converter=as_floats, default=0.008)
    """Height at which the vehicle touches the deck, m."""
    low_height: Scalar = eqx.field(converter=as_floats, default=0.03)
    """Height in m below which contact is assumed after ``low_time``."""
    low_time: Scalar = eqx.field(converter=as_floats, default=0.25)
    """s"""
    search_rate: Scalar = eqx.field(converter=as_floats, default=0.12)
    """Growth of the spiral in which an approach looks for a deck out of sight, m/s."""
    search_turn: Scalar = eqx.field(converter=as_floats, default=1.2)
    """Its turning rate at first, rad/s."""
    search_descent: Scalar = eqx.field(converter=as_floats, default=0.06)
    """Its descent, m/s: by drift, the deck may lie deeper than the deck sensor's range."""
    search_depth: Scalar = eqx.field(converter=as_floats, default=0.9)
    """m of descent at most; less than ``approach_height``."""
    search_time: Scalar = eqx.field(converter=as_floats, default=30.0)
    """s after which an approach that found no deck is given up."""
    deck_lost: Scalar = eqx.field(converter=as_floats, default=0.4)
    """s without sight of the deck after which a landing ends."""
    tracking_error: Scalar = eqx.field(converter=as_floats, default=0.8)
    """Distance in m from the plan at which the cruise ends."""
    least_height: Scalar = eqx.field(converter=as_floats, default=0.45)
    """Height over a deck in sight, within ``near_deck``, at which a cruise ends in a climb, m."""
    near_deck: Scalar = eqx.field(converter=as_floats, default=1.0)
    """Horizontal distance from the deck's centre, m."""
    strongest_wind: Scalar = eqx.field(converter=as_floats, default=6.0)
    """Horizontal disturbance in N at which the mission is given up."""
    time_limit: Scalar = eqx.field(converter=as_floats, default=240.0)
    """Flight time in s that the battery allows."""
    attempts: int = eqx.field(static=True, default=3)
    """Approaches before the mission is given up."""
