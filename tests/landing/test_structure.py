"""Parts that are missing or of another class are named before anything is compiled; so are plans of another shape."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp import InvalidScenario
from jaxscp.landing.structure import check_parts
from jaxscp.solver import pipeline
from tests.support.rooms import room

ROOM = room()
PLANNER = jaxscp.Planner(nodes=5)


@pytest.fixture(autouse=True)
def _nothing_may_compile(monkeypatch):
    def compiled(*args):
        raise AssertionError("the planner was compiled before its input was checked")

    compiled.function = compiled
    monkeypatch.setattr(pipeline, "_solve", compiled)


def unchecked(field, part):
    """The scenario with another part, put there as a study puts arrays: without the constructor."""
    return eqx.tree_at(lambda s: getattr(s, field), ROOM, part, is_leaf=lambda v: v is None)


def search(passage):
    """Result of a search through a wall, with a passage or without."""
    wall = [[3.0, y, z] for y in np.arange(-5, 5, 0.2) for z in np.arange(0, 5, 0.2) if not passage or y < 0]
    around = {"lower": [-1, -5, 0], "upper": [11, 5, 5]}
    return jaxscp.corridor.build_corridor(wall, [0, 0, 1], [6, 1, 1], radius=0.3, **around)


WRONG = {
    "corridor": unchecked("corridor", None),
    "corridor: expected .* Corridor, got one of class Polytope": unchecked(
        "corridor", jaxscp.corridor.box([0.0] * 3, [1.0] * 3)
    ),
    "corridor: .* build_corridor found no route, the message": unchecked("corridor", search(False).corridor),
    r"weights: .* tuple; jaxscp\.Weights\(control=": unchecked("weights", (0.1, 1.0)),
    "start: expected .* BodyState, got one of class tuple": unchecked("start", (0.0, 0.0, 1.0)),
    r"start: .* got an array of shape \(13,\).*at_rest.*BodyState\.of\(x\)": unchecked("start", np.zeros(13)),
    "goal": unchecked("goal", None),
    "limits": unchecked("limits", None),
    "weights": unchecked("weights", None),
    "cone_angle: expected an array, got one of class str": unchecked("cone_angle", "wide"),
    "keep_out": unchecked("keep_out", [1.0]),
    "goal_fixed": unchecked("goal_fixed", True),
    "deck_velocity": unchecked("deck_velocity", (1.0, 0.0, 0.0)),
    r"airframe\.body\.mass: expected an array, got None": eqx.tree_at(
        lambda s: s.airframe.body.mass, ROOM, None
    ),
    r"airframe\.body: .* DoubleIntegrator": eqx.tree_at(
        lambda s: s.airframe.body, ROOM, jaxscp.DoubleIntegrator(1)
    ),
}


def test_the_result_of_a_search_is_no_corridor_but_has_one():
    with pytest.raises(InvalidScenario, match=r"give the field corridor of this result: found\.corridor"):
        check_parts(unchecked("corridor", search(passage=True)))
    with pytest.raises(InvalidScenario, match="this result holds none: no route: "):
        check_parts(unchecked("corridor", search(passage=False)))


@pytest.mark.parametrize("words", WRONG)
@pytest.mark.parametrize("act", [PLANNER, PLANNER.compile], ids=["plan", "compile"])
def test_a_wrong_part_is_named(words, act):
    with pytest.raises(InvalidScenario, match=words):
        act(WRONG[words])


def test_a_wrong_part_is_named_under_transformations():
    def cost(mass):
        return PLANNER(eqx.tree_at(lambda s: s.airframe.body.mass, WRONG["goal"], mass)).cost

    for transformed in (jax.vmap(cost), jax.grad(lambda m: cost(m[0]))):
        with pytest.raises(InvalidScenario, match="goal"):
            transformed(jnp.array([0.9, 1.0]))


@pytest.mark.parametrize("other", [None, [ROOM], type(ROOM), ROOM.airframe])
def test_anything_but_a_scenario_is_refused(other):
    """Asked of the check alone: annotations are checked at run time in tests, and would come first."""
    with pytest.raises(InvalidScenario, match="scenario: expected one, got"):
        pipeline._check_class(other)


def test_no_limits_are_none():
    none = dataclasses.replace(ROOM, limits=None)
    jaxscp.validate(none, 5)
    assert jax.tree.structure(none) == jax.tree.structure(ROOM)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("nodes", 1),
        ("nodes", "30"),
        ("nodes", 30.5),
        ("samples", 1),
        ("method", jaxscp.PTR),
        ("method", None),
    ],
)
def test_a_wrong_field_of_the_planner_is_named(field, value):
    with pytest.raises(InvalidScenario, match=f"^{field}: "):
        eqx.tree_at(lambda p: getattr(p, field), PLANNER, value)(ROOM)


def path(nodes=5, states=13, controls=4):
    shapes = (nodes, states), (nodes, controls)
    return jaxscp.Trajectory.from_arrays(np.arange(nodes), *(np.zeros(shape) for shape in shapes))


@pytest.mark.parametrize(
    ("plan", "words"),
    [
        (path(nodes=7), "has 7 nodes, but the planner has 5"),
        (path(states=12), r"state: has 12 columns, but the scenario has 13 states"),
        (path(controls=6), r"control: has 6 columns, but the scenario has 4 rotors"),
    ],
)
def test_a_replan_from_a_plan_of_another_shape_is_refused(plan, words):
    with pytest.raises(InvalidScenario, match=words):
        PLANNER.replan(plan, ROOM)


@pytest.mark.parametrize("other", [None, ROOM])
def test_anything_but_a_plan_is_refused(other):
    with pytest.raises(InvalidScenario, match="solution: expected a Solution or a Trajectory, got"):
        PLANNER.pipeline._check_plan(other)


@pytest.mark.parametrize("elapsed", [-0.1, float("nan"), float("inf")])
def test_a_time_before_the_plan_is_refused(elapsed):
    with pytest.raises(InvalidScenario, match="elapsed: expected seconds since the old plan's start"):
        PLANNER.replan(path(), ROOM, elapsed)


def test_a_scenario_in_flight_is_checked_before_its_rest_is_taken():
    broken = eqx.tree_at(lambda s: s.corridor, ROOM, None)
    with pytest.raises(InvalidScenario, match="corridor: expected a part of class Corridor, got None"):
        PLANNER.replan(path(), broken, 0.5)


def test_a_time_after_the_end_of_the_plan_is_refused():
    with pytest.raises(
        InvalidScenario, match=r"elapsed: the old plan ended after 4 s, before elapsed = 4\.5 s"
    ):
        PLANNER.replan(path(), ROOM, 4.5)


def test_a_plan_of_invalid_input_is_named():
    nothing = eqx.tree_at(lambda t: t.state, path(), jnp.full_like(path().state, jnp.nan))
    with pytest.raises(InvalidScenario, match="solution: its trajectory holds NaN"):
        PLANNER.replan(nothing, ROOM, 0.5)


def test_a_stack_of_plans_needs_vmap():
    with pytest.raises(InvalidScenario, match=r"1 leading axes; use jax\.vmap"):
        PLANNER.replan(jax.tree.map(lambda v: jnp.stack([v, v]), path()), ROOM)


@pytest.mark.parametrize("none", [jaxscp.ellipsoids([], []), jaxscp.ellipsoids(np.zeros((0, 3)), 0.5)])
@pytest.mark.parametrize("zones", ["keep_out", "gates"])
def test_no_zone_is_none(zones, none):
    scenario = dataclasses.replace(ROOM, **{zones: none})
    jaxscp.validate(scenario, 5)
    problem, _ = scenario.problem(5, PLANNER.method.form)
    names = [constraint.name for constraint in problem.constraints]
    assert names == ["corridor", "thrust", "landing cone"]
