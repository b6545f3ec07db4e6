"""A cheap study: the points of a ball's throw. Importable, so that other processes run it."""

import sys
import time
from pathlib import Path

import numpy as np

from jaxscp import monte_carlo as mc

BASE = {"speed": 10.0, "angle": 0.7}


def throw(ball):
    """Range and a path of five points."""
    reach = ball["speed"] ** 2 * np.sin(2.0 * ball["angle"]) / 9.81
    along = np.linspace(0.0, 1.0, 5)
    path = {"place": np.stack([reach * along, along * (1.0 - along)], axis=1), "step": np.arange(5)}
    return mc.Outcome({"success": reach > 9.5, "range": reach, "count": np.int32(3)}, path)


def slow_throw(ball):
    """The same after two milliseconds."""
    time.sleep(0.002)
    return throw(ball)


def study(count=200, seed=1, run=throw):
    parameters = (
        mc.Parameter("speed", mc.Normal(10.0, 0.5), unit="m/s"),
        mc.Parameter("angle", mc.Uniform(0.6, 0.9), unit="rad"),
    )
    return mc.Study(run, BASE, parameters, mc.Independent(count, seed), units={"range": "m"})


if __name__ == "__main__":  # a driver to kill
    mc.sweep(study(400, run=slow_throw), Path(sys.argv[1]), keep=mc.FailedTrajectories(), chunk=20)
