"""Random chains of three to eight boxes for random vehicles, each with a motion that shows that it can be flown.

A chain follows way-points along the axes: each box holds one way. Neighbours share a cube of 20 cm at least. Of eight
polytopes and six faces, all chains share one program.
"""

from typing import NamedTuple

import numpy as np

import jaxscp
from benchmarks.robustness.witness import Witness, witness
from jaxscp.corridor import box, connect, pad
from jaxscp.dynamics.rotations import rotation_matrix

MOST_BOXES = 8
LENGTHS = (0.8, 4.0)  # m, of a way
HALF_WIDTHS = (0.1, 0.8)  # m, of a box across its way
MASSES = (0.03, 30.0)  # kg
LOADS = (1.4, 4.0)  # full thrust over weight
TIME_WEIGHTS = (0.0, 1.0, 5.0, 100.0)
LONGEST = 60.0  # s
PAPER_MASS, PAPER_ARM, PAPER_INERTIA = 0.928, 0.076, (2.5e-3, 2.1e-3, 4.3e-3)
GRAVITY = 9.81


class Chain(NamedTuple):
    """A scenario, and a motion through it."""

    scenario: jaxscp.LandingScenario
    witness: Witness


def chain(seed: int, boxes: int | None = None) -> Chain:
    """A random chain, of so many boxes if given; draws that no slow motion flies are drawn anew."""
    random = np.random.default_rng([seed, 41])
    while True:
        points, halves = _ways(random, boxes)
        scenario = _scenario(random, points, halves)
        heading = np.asarray(rotation_matrix(scenario.start.attitude))
        found = witness(scenario.airframe, _legs(points, halves) @ heading, float(scenario.dilation_max))
        if found is not None:
            return Chain(scenario, found)


def vehicle(mass: float, load: float) -> jaxscp.airframes.Airframe:
    """A quadrotor like the paper's: lengths grow with the cube root of the mass."""
    size = (mass / PAPER_MASS) ** (1.0 / 3.0)
    inertia = np.array(PAPER_INERTIA) * (mass / PAPER_MASS) * size**2
    hover = mass * GRAVITY / 4.0
    return jaxscp.airframes.multirotor(
        mass=mass,
        inertia=inertia,
        arm=PAPER_ARM * size,
        torque_ratio=0.016 * size,
        thrust_min=0.1 * hover,
        thrust_max=load * hover,
    )


def _ways(random: np.random.Generator, boxes: int | None) -> tuple[np.ndarray, np.ndarray]:
    """Way-points (boxes + 1, 3) and half-widths (boxes,), m; each way turns, and some rise or fall."""
    count = boxes or int(random.integers(3, MOST_BOXES + 1))
    points, axis = [np.array([0.0, 0.0, 2.0])], 0
    for _ in range(count):
        axis = int(random.choice([a for a in range(3) if a != axis or len(points) == 1]))
        step = np.zeros(3)
        step[axis] = random.uniform(*LENGTHS) * random.choice([-1.0, 1.0])
        points.append(points[-1] + step)
    return np.array(points), random.uniform(*HALF_WIDTHS, count)


def _scenario(random: np.random.Generator, points: np.ndarray, halves: np.ndarray) -> jaxscp.LandingScenario:
    boxes = [
        box(list(np.minimum(a, b) - h), list(np.maximum(a, b) + h))
        for a, b, h in zip(points[:-1], points[1:], halves, strict=True)
    ]
    goal = points[-1] - [0.0, 0.0, 0.9 * halves[-1]]
    corridor = pad(connect(boxes, joints=points[1:-1]), goal, polytopes=MOST_BOXES)
    mass = float(np.exp(random.uniform(*np.log(MASSES))))
    yaw = float(random.uniform(-np.pi, np.pi))
    return jaxscp.scenarios.through(
        corridor,
        jaxscp.at_rest(points[0], yaw),
        jaxscp.at_rest(goal, yaw),
        airframe=vehicle(mass, float(random.uniform(*LOADS))),
        weights=jaxscp.Weights(1.0 / mass, float(random.choice(TIME_WEIGHTS))),
        dilation_max=LONGEST,
    )


def _legs(points: np.ndarray, halves: np.ndarray) -> np.ndarray:
    """Way-points of the motion: the chain's, then straight down to the goal."""
    return np.concatenate([points, points[-1:] - [[0.0, 0.0, 0.9 * halves[-1]]]])


def clearance(scenario: jaxscp.LandingScenario, positions: np.ndarray) -> float:
    """Least distance inside the union of the polytopes over positions (samples, 3), m; negative outside."""
    normals, offsets = np.asarray(scenario.corridor.normals), np.asarray(scenario.corridor.offsets)
    inside = np.min(offsets[None] - np.einsum("kfc,sc->skf", normals, positions), axis=2)
    return float(np.min(np.max(inside, axis=1)))
