"""Gates anywhere in a room: each is passed, in the order given, however far from the straight way."""

import dataclasses

import numpy as np
import pytest

import jaxscp
from tests.support.rooms import room

GATE = 0.1  # m
MILLIMETRE = 1e-3
ORDERS = [
    pytest.param([[5.0, 2.0, 2.0]], id="one", marks=pytest.mark.nightly),
    pytest.param([[5.0, 2.0, 2.0], [1.0, -2.0, 2.0]], id="there and back", marks=pytest.mark.nightly),
    pytest.param([[1.0, -2.0, 2.0], [5.0, 2.0, 2.0]], id="on the way", marks=pytest.mark.slow),
    pytest.param([[5.0, 2.0, 2.0], [3.0, 0.0, 1.0], [1.0, -2.0, 2.0]], id="three", marks=pytest.mark.nightly),
]


@pytest.mark.parametrize("centres", ORDERS)
def test_gates_are_passed_in_order(centres):
    scenario = dataclasses.replace(room(), gates=jaxscp.ellipsoids(centres, GATE))
    solution = jaxscp.Planner()(scenario)
    assert jaxscp.status_names(solution.status) == "converged"
    assert bool(solution.differentiable)
    samples = solution.trajectory.sample(rate=1000.0)
    away = np.linalg.norm(np.asarray(samples.state)[:, None, :3] - np.array(centres), axis=2)
    step = 1e-3 * np.linalg.norm(np.asarray(samples.state)[:, 3:6], axis=1).max()
    assert np.all(away.min(axis=0) <= GATE + MILLIMETRE + step)
    assert np.all(np.diff(away.argmin(axis=0)) > 0)
