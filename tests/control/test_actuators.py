"""Lag and delay of the controls."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxscp.control import Actuators


def test_a_step_follows_the_exponential():
    motors = Actuators([0.0], [10.0], time_constant=0.05)
    active = jnp.array([1.0])
    for _ in range(10):
        active = motors.advance(active, [3.0], 0.01)
    np.testing.assert_allclose(active, 3.0 - 2.0 * np.exp(-0.1 / 0.05), rtol=1e-12)


@pytest.mark.parametrize("time_constant", [0.0, 0.03])
def test_the_command_reaches_its_target(time_constant):
    motors = Actuators([0.0, 0.0], [10.0, 10.0], time_constant=time_constant)
    command = motors.command([2.0, 3.0], [2.2, 2.9], 0.01)
    np.testing.assert_allclose(motors.advance([2.0, 3.0], command, 0.01), [2.2, 2.9], rtol=1e-12)


def test_the_command_stays_within_the_bounds():
    motors = Actuators([0.3], [5.0], time_constant=0.03)
    assert motors.command([2.0], [4.9], 0.01).tolist() == [5.0]
    assert motors.command([2.0], [0.4], 0.01).tolist() == [0.3]


def test_wrong_requests_name_the_field():
    with pytest.raises(ValueError, match="lower, upper"):
        Actuators([0.0], [1.0, 2.0])
    with pytest.raises(ValueError, match="delay"):
        Actuators([0.0], [1.0], delay=-1)
    for wrong in (([2.0], [-2.0]), ([0.0], [np.nan])):
        with pytest.raises(ValueError, match="lower, upper: the least control must not exceed"):
            Actuators(*wrong)
    for rate in (0.0, -1.0, np.nan, [1.0, 0.0]):
        with pytest.raises(ValueError, match="rate"):
            Actuators([0.0, 0.0], [1.0, 1.0], rate=rate)
    for lag in (-0.1, np.nan, np.inf):
        with pytest.raises(ValueError, match="time_constant"):
            Actuators([0.0], [1.0], time_constant=lag)
