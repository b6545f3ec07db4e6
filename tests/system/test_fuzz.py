"""Inputs of the fuzzer: none may end in a fault. The long run is ``python -m benchmarks.fuzz``."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.fuzz.case import FAULTS
from benchmarks.fuzz.driver import case_of, run_all, run_case
from benchmarks.fuzz.oracle import World, faults
from jaxscp import at_rest
from jaxscp.dynamics.airframes import paper_mav
from jaxscp.landing.mission import FlightLimits

HOVER = 0.928 * 9.81 / 4.0  # N a rotor


def hovering(seconds=2.0, thrust=HOVER):
    """A scenario and a plan that hovers at one place."""
    state = np.tile(np.asarray(at_rest([0.0, 0.0, 1.0]).vector()), (5, 1))
    path = SimpleNamespace(control=np.full((5, 4), thrust), dilation=np.full(5, seconds))
    scenario = SimpleNamespace(
        airframe=paper_mav(),
        start=at_rest([0.0, 0.0, 1.0]),
        goal=at_rest([0.0, 0.0, 1.0]),
        limits=FlightLimits(),
    )
    return scenario, SimpleNamespace(trajectory=path, state=state)


def test_the_oracle_finds_no_fault_in_a_hover():
    scenario, plan = hovering()
    room = np.array([-1.0, -1.0, 0.0]), np.array([1.0, 1.0, 2.0])
    assert faults(scenario, plan, World(free=[room], margin=1.0)) == ""


def test_the_oracle_finds_a_plan_that_misses_or_touches():
    scenario, plan = hovering(thrust=1.01 * HOVER)
    assert "final position off by 0.196" in faults(scenario, plan, World())  # 0.01 g t^2 / 2
    scenario, plan = hovering()
    below = np.array([-1.0, -1.0, -1.0]), np.array([1.0, 1.0, 0.9])
    assert "0.1 m of matter" in faults(scenario, plan, World(solid=[below], least=0.25))
    assert "0.2 m of a point" in faults(
        scenario, plan, World(points=np.array([[0.0, 0.2, 1.0]]), least_points=0.3)
    )


def test_the_oracle_knows_polytopes_with_normals_of_any_length():
    scenario, plan = hovering()
    # 0.5 m < z < 1.2 m, and padding
    normals = 3.0 * np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 0.0, 0.0]])
    assert faults(scenario, plan, World(cells=[(normals, np.array([3.6, -1.5, 1.0]))])) == ""
    found = faults(scenario, plan, World(cells=[(normals, np.array([2.7, -1.5, 1.0]))]))
    assert "leaves the polytopes by 0.1 m" in found


@pytest.mark.nightly
def test_a_face_that_a_number_turned_is_another_corridor():
    """A 0 in this case's normals became -1: a slanted face, behind which the plan leaves the old box."""
    assert run_case(7865, case_of(6011, 7865)).ending == "converged"


@pytest.mark.parametrize("kind", ["file", "command"])
def test_inputs_that_need_no_compilation(kind):
    count = {"file": 40, "command": 30}[kind]
    cases = [(number, case_of(7, number, (kind,))) for number in range(count)]
    planning = "", "a wrong weight"
    records = [run_case(n, case) for n, case in cases if kind == "file" or case.mutation not in planning]
    assert not [record for record in records if record.ending in FAULTS]
    assert {record.ending for record in records} & {"accepted", "refused"}


@pytest.mark.nightly
def test_inputs_of_every_kind():
    records = list(run_all(300, 11, ("scenario", "corridor", "cloud", "file", "command")))
    assert not [record for record in records if record.ending in FAULTS]
    assert sum(record.ending == "converged" for record in records) >= 100
