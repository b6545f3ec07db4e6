"""Landings alone: up from the deck, and down again at once; many seeds in one program.

Quicker than whole missions, which also cruise and plan. World, vehicle, sensors and pilot are those of a mission.

    python -m benchmarks.landings [--json] [--field outdoor] [--wind 8] [--count 16] [--first 0]
"""

import argparse
import json
import time
from typing import Any

import equinox as eqx
import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

from jaxscp.mission import Choices, Outcome, Phase, draw_case  # noqa: E402
from jaxscp.mission.cases import Case, sent_off  # noqa: E402
from jaxscp.mission.member import Record, nominal_pilot  # noqa: E402
from jaxscp.mission.outcome import assess  # noqa: E402
from jaxscp.simulation import Sensors, begin  # noqa: E402
from jaxscp.simulation.simulate import advance  # noqa: E402
from jaxscp.simulation.vehicles import FEET_DEPTH  # noqa: E402

FIELDS = "indoor", "outdoor"
SENT_OFF, PERIODS = 7.0, 1400  # s at which the deck begins to move, and 10 ms of a landing


def landings(cases: list[Case]) -> list[Outcome]:
    """What happens in each case. Its obstacles and its goal count for nothing."""
    arrays, rest = zip(
        *(eqx.partition(sent_off(case.world, SENT_OFF), eqx.is_array) for case in cases), strict=True
    )
    worlds = jax.tree.map(lambda *leaves: jnp.stack(leaves), *arrays)
    keys = jnp.stack([case.key for case in cases])
    run = jax.jit(jax.vmap(lambda world, key: _fly(eqx.combine(world, rest[0]), key)))
    phases, attempts, flights = jax.tree.map(np.asarray, run(worlds, keys))
    found = []
    for row in range(len(cases)):
        record, flight = Record(), jax.tree.map(lambda v, row=row: v[row], flights)
        record.add(Phase(int(phases[row])), flight, np.full(len(flight.vehicle), np.inf))
        found.append(assess(record, int(attempts[row]), np.asarray(cases[row].goal)))
    return found


def _fly(world, key):
    """Last phase, approaches, and the true histories."""
    pilot, sensors = nominal_pilot(), Sensors()
    deck = world.course.start.at[2].add(sensors.deck_filter.height + FEET_DEPTH)
    first = pilot.init(jnp.zeros(13).at[6].set(1.0).at[:3].set(deck))

    def function(state, observation, now):
        waits = state.phase == int(Phase.hover)
        state = jax.tree.map(lambda a, b: jnp.where(waits, a, b), pilot.with_approach(state, now), state)
        return pilot(state, observation, now)

    loop, flight = advance(world, sensors, function, begin(world, sensors, first, key), PERIODS)
    return loop.controller.phase, loop.controller.attempts, flight


def summary(found: list[Outcome]) -> dict[str, Any]:
    """Shares and quantiles; None where nothing touched down."""
    contacts = [one for one in found if np.isfinite(one.tilt)]
    of = lambda name, share: float(np.quantile([getattr(one, name) for one in contacts], share))  # noqa: E731
    rows = {
        "touchdown_median_m": ("touchdown", 0.5),
        "touchdown_p95_m": ("touchdown", 0.95),
        "tilt_median_deg": ("tilt", 0.5),
        "tilt_greatest_deg": ("tilt", 1.0),
        "vertical_speed_greatest": ("vertical_speed", 1.0),
    }
    figures = {key: of(*row) if contacts else None for key, row in rows.items()}
    landed = {"landings": len(found), "landed": sum(one.landed for one in found)}
    return landed | {"first_approach": sum(one.landed and one.attempts == 1 for one in found)} | figures


def main() -> None:
    """Fly, and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--field", choices=FIELDS, default="outdoor")
    parser.add_argument("--wind", type=float, help="mean wind outdoors in m/s instead of 0 to 8")
    parser.add_argument("--count", type=int, default=16)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    asked = parser.parse_args()
    choices = Choices(wind=asked.wind if asked.field == "outdoor" else None)
    began = time.perf_counter()
    found = landings([draw_case(asked.field, asked.first + k, choices) for k in range(asked.count)])
    figures = summary(found) | {"seconds": time.perf_counter() - began}
    if asked.json:
        print(json.dumps(figures))
        return
    for key, value in figures.items():
        print(f"{key:24} {value}")
    for k, one in enumerate(found):
        if not one.landed or one.attempts > 1:
            print(f"seed {asked.first + k}: {one.end}, {one.attempts} approaches, collision: {one.collision}")


if __name__ == "__main__":
    main()
