"""The commander on a craft that has no truth at all: it plans from scans, stops, returns and lands."""

import types

import numpy as np
import pytest

import jaxscp
from jaxscp.mission import INDOOR, Phase
from jaxscp.mission.commander import Commander, Task
from jaxscp.mission.mapping import clearance
from jaxscp.mission.planning import Planned, retreat

GOAL = np.array([5.0, 17.0, 2.0])
HOME = np.array([1.5, 2.0, 2.16])
UP = np.array([0.0, 0.0, 1.05])
WALL = np.array([[5.0, y, z] for y in (9.0, 9.2) for z in (1.0, 1.2)])


class FakeCraft:
    """Estimates, scans and orders."""

    rules = types.SimpleNamespace(return_height=1.0)

    def __init__(self, scans=()):
        self.phase, self.time = Phase.hover, 3.0
        self.place, self.scans, self.orders = HOME + UP, list(scans), []

    def state(self):
        return np.concatenate([self.place, np.zeros(10)])

    def deck(self):
        return HOME

    def scan(self):
        return self.scans.pop(0) if self.scans else WALL

    def follow(self, trajectory):
        self.orders.append("plan")
        return trajectory

    def stop(self, place):
        self.orders.append("stop")

    def land(self):
        self.orders.append("approach")


def straight(start, goal):
    path = np.linspace(start, goal, 50)
    states = np.concatenate([path, np.zeros((50, 10))], axis=1)
    return types.SimpleNamespace(start=0.0, step=0.1, state=states, at=lambda time: (states[5], None))


class FakePlanner:
    """A straight line, or none."""

    def __init__(self, fails=0):
        self.fails = fails

    def plan(self, cloud, start, goal, deck):
        if self.fails:
            self.fails -= 1
            return Planned(None, "no route")
        return Planned(straight(start, goal), "converged")


def commander(planner=None, scans=()):
    return Commander(FakeCraft(scans), planner or FakePlanner(), INDOOR, GOAL)


def test_a_mission_goes_out_and_back_and_lands():
    one = commander()
    craft = one.craft
    one.look()
    assert (one.task, craft.orders) == (Task.out, ["plan"])
    craft.place = GOAL + 0.1
    one.look()
    assert (one.task, craft.orders) == (Task.back, ["plan", "plan"])
    craft.place = HOME + UP
    one.look()
    assert (one.task, craft.orders[-1]) == (Task.landing, "approach")
    craft.phase = Phase.landed
    one.look()
    assert one.task == Task.done


@pytest.mark.parametrize("in_the_way", [True, False])
def test_a_plan_that_a_new_scan_blocks_is_stopped(in_the_way):
    one = commander()
    craft = one.craft
    craft.phase = Phase.cruise
    one.references.append(straight(craft.place, GOAL))
    further = 0.2 * craft.place + 0.8 * GOAL  # the first 3 s of the plan are over
    craft.scans = [further + np.array([[0.05 if in_the_way else 1.0, 0.0, 0.0]])]
    one.look()
    assert craft.orders == (["stop"] if in_the_way else [])


def test_without_a_route_the_vehicle_goes_home():
    one = commander(FakePlanner(fails=6))
    for _ in range(7):
        one.look()
    assert one.task == Task.landing  # it never left
    assert one.aborts == ["no route to the goal"]


@pytest.mark.parametrize("close", [True, False])
def test_without_a_plan_the_vehicle_draws_back_from_what_is_close(close):
    beside = HOME + UP + np.array([[0.6 if close else 1.5, 0.0, 0.0]])
    one = commander(FakePlanner(fails=1), scans=[beside])
    one.look()
    assert one.craft.orders == (["stop"] if close else [])
    one.look()
    assert one.craft.orders[-1] == "plan"


def test_between_two_walls_there_is_no_place_to_draw_back_to():
    walls = np.array([[0.6, 0.0, 0.0], [-0.6, 0.0, 0.0]])
    assert retreat(walls, np.zeros(3)) is None


def test_clearance_is_the_least_distance():
    way = np.zeros((3, 3)) + np.arange(3.0)[:, None] * np.array([1.0, 0.0, 0.0])
    assert clearance(np.array([[1.0, 0.4, 0.0], [9.0, 9.0, 9.0]]), way) == pytest.approx(0.4)
    assert clearance(np.zeros((0, 3)), way) == np.inf


def test_an_unknown_field_is_refused():
    from jaxscp.mission import draw_case

    with pytest.raises(ValueError, match="indoor or outdoor"):
        draw_case("underwater", 0)


@pytest.mark.slow
def test_the_same_seed_draws_the_same_case():
    from jaxscp.mission import draw_case

    one, two, other = draw_case("indoor", 4), draw_case("indoor", 4), draw_case("indoor", 5)
    assert np.array_equal(one.goal, two.goal)
    assert float(one.world.airframe.body.mass) == float(two.world.airframe.body.mass)
    assert not np.array_equal(one.goal, other.goal)
    assert (
        abs(float(one.world.airframe.body.mass) / float(jaxscp.airframes.paper_mav().body.mass) - 1.0) <= 0.1
    )
