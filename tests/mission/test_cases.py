"""Cases of missions: what may be asked for."""

import pytest

pytest.importorskip("mujoco.mjx", reason="needs the extra simulation")

from jaxscp.mission import Choices, draw_case


@pytest.mark.parametrize("speed", [float("nan"), float("inf"), -1.0, 1e6])
@pytest.mark.parametrize("name", ["wind", "deck_speed"])
def test_impossible_speeds_are_named(name, speed):
    with pytest.raises(ValueError, match=f"^{name}: expected a speed from 0 to"):
        Choices(**{name: speed})


@pytest.mark.usefixtures("no_type_checks")
@pytest.mark.parametrize("seed", [-1, 2**63, 2**64 - 1, 1.5, "1"])
def test_seeds_that_no_key_holds_are_named(seed):
    with pytest.raises(ValueError, match=r"^seed: expected a whole number from 0 to"):
        draw_case("indoor", seed)
