"""The airframe of the simulation."""

from jaxscp.dynamics.airframes import Airframe, multirotor


def simulated_mav() -> Airframe:
    """The paper's vehicle with 6.25 N a rotor: 0.928 kg, 25 N in all.

    ``paper_mav`` has 20 N, and hovers at 45.5 % of it. The paper needs about that share to leave the deck, against
    suction; it follows that the real vehicle has more thrust. Hover takes 36.4 % here.

    Example:
        >>> float(simulated_mav().thrust_max.sum())
        25.0
    """
    return multirotor(
        mass=0.928,
        inertia=[2.5e-3, 2.1e-3, 4.3e-3],
        arm=0.076,
        torque_ratio=0.016,
        thrust_min=0.1,
        thrust_max=6.25,
    )
