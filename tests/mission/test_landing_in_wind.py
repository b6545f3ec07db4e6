"""Landings alone, in wind: the vehicle leans against it, and levels off just above the deck."""

import pytest

from jaxscp.mission import Choices, draw_case

WIND = 8.0  # m/s: hover leans by 15 degrees
LEVEL, SOFT, NEAR = 5.0, 0.5, 0.08  # degrees, m/s and m at the first contact: the project's aims


@pytest.mark.nightly
def test_vehicles_touch_the_deck_level():
    from benchmarks.landings import landings

    for found in landings([draw_case("outdoor", seed, Choices(wind=WIND)) for seed in (0, 1)]):
        assert found.landed
        assert found.tilt < LEVEL
        assert found.vertical_speed < SOFT
        assert found.touchdown < NEAR
