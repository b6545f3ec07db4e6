"""Time and accuracy of a control tick, and tracking of an adaptive plan and of a plan on a uniform mesh.

A tick is one call of a compiled ``NMPC``: 13 states, 4 thrusts, ten intervals in a second, motors with a delay of two
ticks and a first-order lag, disturbance estimate included. The process runs on one core. Ticks are timed along a flight
that meets the thrust limits.

The same convex program is solved by OSQP and CLARABEL at tight tolerance. ``rivals/acados_rti.py`` times
acados' real-time iteration, in an environment of its own.

    python -m benchmarks.control [--json] [--ticks 3000]
"""

import argparse
import json
import os
import time
from typing import Any

if hasattr(os, "sched_setaffinity"):  # one core, before JAX makes its threads
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})

import jax

jax.config.update("jax_enable_x64", True)

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import jaxscp  # noqa: E402
from jaxscp.control import NMPC, Reference  # noqa: E402
from tests.support import closed_loop  # noqa: E402
from tests.support.bounded_programs import solution_of_clarabel, solution_of_osqp  # noqa: E402
from tests.support.flights_under_control import (  # noqa: E402
    CALM,
    HOVER,
    ROUGH,
    adaptive_plan,
    controller,
    flight_along,
    program_of,
    tracking_error,
    uniform_plan,
)

EXACT = 14  # interior-point steps: to rounding


def timings(nmpc: NMPC, reference: Reference, ticks: int) -> np.ndarray:
    """Milliseconds of each tick along a flight, by the clock and of the processor; the plant is not counted."""
    plant = closed_loop.Plant(nmpc.dynamics, nmpc.actuators, closed_loop.NOISE)
    control = jax.jit(lambda state, estimate, now: nmpc(reference, state, estimate, now))
    advance = jax.jit(lambda state, thrust, command, now: plant.advance(state, thrust, command, now, 0.01))
    length = int(float(reference.step) * (reference.state.shape[0] - 2) * 100)
    start = reference.state[0]
    found = []
    while len(found) < ticks:
        state, memory = start, nmpc.init(reference, start)
        thrust = memory.active
        commands = [thrust] * plant.motors.delay
        for number in range(length):
            now = jnp.asarray(0.01 * number)
            jax.block_until_ready((memory, state))
            began = time.perf_counter(), time.process_time()
            memory, command = jax.block_until_ready(control(memory, state, now))
            ended = time.perf_counter(), time.process_time()
            found.append([1e3 * (b - a) for a, b in zip(began, ended, strict=True)])
            commands.append(command)
            state, thrust = advance(state, thrust, commands.pop(0), now)
    return np.array(found[length:])  # the first flight compiles


def accuracy(reference: Reference) -> dict[str, float]:
    """Largest difference in N between thrusts of the horizon, by our interior point and by other solvers.

    Once with as many steps as the program needs, and once with the steps of a tick.
    """
    rows: dict[str, list[float]] = {"osqp": [], "clarabel": [], "clarabel_in_a_tick": []}
    for offset in (0.0, 0.3, -1.0):
        state = reference.state[0].at[0].add(offset)
        qp, exact = program_of(controller(EXACT), reference, state)
        other = solution_of_clarabel(qp)
        _, in_a_tick = program_of(controller(), reference, state)
        found = (exact - solution_of_osqp(qp), exact - other, in_a_tick - other)
        for values, difference in zip(rows.values(), found, strict=True):
            values.append(float(np.max(np.abs(difference))))
    return {f"qp_difference_{name}_n": max(values) for name, values in rows.items()}


def tracking(nmpc: NMPC) -> dict[str, Any]:
    """Root-mean-square position errors in m along both plans, calm and rough."""
    found = {}
    for name, solution in (("adaptive", adaptive_plan()), ("uniform", uniform_plan())):
        found[f"final_time_{name}_s"] = float(solution.final_time)
        found[f"status_{name}"] = str(jaxscp.status_names(solution.status))
        reference = nmpc.follow(solution.trajectory, 0.0, HOVER)
        for air, plant in (("", CALM), ("_rough", ROUGH)):
            key = jax.random.key(0) if air else None
            record = flight_along(nmpc, reference, plant, key)
            found[f"tracking_rmse_{name}{air}_m"] = float(tracking_error(record, reference))
    return found


def report(ticks: int) -> dict[str, Any]:
    """All measurements."""
    nmpc = controller()
    reference = nmpc.follow(adaptive_plan().trajectory, 0.0, HOVER)
    times, of_processor = timings(nmpc, reference, ticks).T
    return {
        "nmpc_ms_median": float(np.median(times)),
        "nmpc_ms_p99": float(np.quantile(times, 0.99)),
        "nmpc_processor_ms_median": float(np.median(of_processor)),
        "nmpc_ms_least": float(np.min(times)),
        "ticks": len(times),
        "interior_point_steps": nmpc.horizon.iterations,
        **accuracy(reference),
        **tracking(nmpc),
    }


def main() -> None:
    """Print the report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--ticks", type=int, default=3000)
    options = parser.parse_args()
    found = report(options.ticks)
    if options.json:
        print(json.dumps(found, indent=1))
    else:
        for name, value in found.items():
            print(f"{name:32} {value:.4g}" if isinstance(value, float) else f"{name:32} {value}")


if __name__ == "__main__":
    main()
