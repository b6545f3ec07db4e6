"""The take-off anomaly: against the deck's suction, a command of 0.5 m fails and one of 1.0 m succeeds.

A proportional controller of position without an integral asks for a thrust in proportion to the commanded height. Below
a height, that is less than weight, suction and the carrier's inflow together: the vehicle stays on the deck. The
mission's own controller estimates the suction, and starts at any command.

    python -m benchmarks.take_off [--json] [--plot FILE]
"""

import argparse
import json

import jax

jax.config.update("jax_enable_x64", True)

import equinox as eqx  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

from jaxscp.simulation import Geometric, Sensors, World, simulate, simulated_mav  # noqa: E402
from jaxscp.simulation.bodies import DECK_HEIGHT  # noqa: E402
from jaxscp.simulation.vehicles import FEET_DEPTH  # noqa: E402

SUCTIONS, COMMANDS = (1.5, 2.2, 2.9), (0.5, 1.0)
GAIN = 4.5  # 1/s^2, of position
TICKS = 800
LEFT = 0.3  # m: higher than this, the vehicle has left the deck


def climbs() -> tuple[np.ndarray, np.ndarray]:
    """Heights of the feet over the deck in m, and total thrusts over the greatest; (suctions, commands, ticks)."""
    world, sensors = World.of(), Sensors()
    pilot = Geometric(simulated_mav(), position_gain=GAIN, integral_gain=0.0)
    deck = world.course.start + jnp.array([0.0, 0.0, DECK_HEIGHT + FEET_DEPTH])

    def climb(suction, command):
        own = eqx.tree_at(lambda w: w.air.suction, world, suction)

        def controller(integral, observation, time):
            return pilot(integral, observation.state(), deck.at[2].add(command), jnp.zeros(3), 0.01)

        flight = simulate(own, sensors, (controller, jnp.zeros(3)), jax.random.key(0), TICKS)
        height = flight.vehicle[:, 2] - flight.carrier[:, 2] - DECK_HEIGHT - FEET_DEPTH
        return height, flight.thrusts.sum(axis=1) / world.motors.thrust_max.sum()

    suctions, commands = jnp.meshgrid(jnp.array(SUCTIONS), jnp.array(COMMANDS), indexing="ij")
    many = jax.jit(jax.vmap(climb))(suctions.ravel(), commands.ravel())
    height, share = (np.asarray(v).reshape(len(SUCTIONS), len(COMMANDS), -1) for v in many)
    return height, share


def figure(height: np.ndarray, share: np.ndarray):
    """Height and thrust against time."""
    from matplotlib.figure import Figure

    from jaxscp.core.picture_style import BLUE, LEGEND, ORANGE

    drawn = Figure(figsize=(8.0, 3.2), layout="constrained")
    left, right = drawn.subplots(1, 2)
    time = 0.005 * np.arange(1, height.shape[2] + 1)
    for j, (command, color) in enumerate(zip(COMMANDS, (ORANGE, BLUE), strict=True)):
        for i, style in enumerate((":", "--", "-")):
            label = f"command {command} m, F0 = {SUCTIONS[i]} N"
            left.plot(time, height[i, j], color=color, linestyle=style)
            right.plot(time, share[i, j], color=color, linestyle=style, label=label)
    left.set(xlabel="time [s]", ylabel="height over the deck [m]")
    right.set(xlabel="time [s]", ylabel="thrust / greatest thrust")
    right.legend(loc="lower right", **LEGEND)
    return drawn


def main() -> None:
    """Fly, print, draw."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--plot", metavar="FILE")
    asked = parser.parse_args()
    height, share = climbs()
    rows = [
        {
            "suction": f,
            "command": c,
            "left": bool(height[i, j].max() > LEFT),
            "peak_thrust": float(share[i, j].max()),
        }
        for i, f in enumerate(SUCTIONS)
        for j, c in enumerate(COMMANDS)
    ]
    print(json.dumps(rows) if asked.json else "\n".join(map(str, rows)))
    if asked.plot:
        figure(height, share).savefig(asked.plot, dpi=110)


if __name__ == "__main__":
    main()
