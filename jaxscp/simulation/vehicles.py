"""The airframe of the simulation."""

import dataclasses

import numpy as np

from jaxscp.dynamics.airframes import Airframe, paper_mav

FEET_DEPTH = 0.05
"""Depth of the feet's lowest points under the vehicle's centre of mass, m."""


def simulated_mav() -> Airframe:
    """The paper's vehicle with 6.25 N a rotor: 0.928 kg, 25 N in all.

    ``paper_mav`` has 20 N, and hovers at 45.5 % of it. The paper needs about that share to leave the deck, against
    suction; it follows that the real vehicle has more thrust. Hover takes 36.4 % here.

    Example:
        >>> float(simulated_mav().thrust_max.sum())
        25.0
    """
    return dataclasses.replace(paper_mav(), thrust_min=np.full(4, 0.1), thrust_max=np.full(4, 6.25))
