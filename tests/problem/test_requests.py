"""Wrong requests: each is refused before anything compiles, by a message that names field and cause."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp as js
from tests.support.own_problems import double_integrator, squared_control, time_taken

pytestmark = pytest.mark.usefixtures("no_type_checks")

ENERGY = js.Cost(running=squared_control)
FIXED, FREE = js.Time(5, js.FixedTime(2.0)), js.Time(5, js.FreeTime(0.1, 10.0))
REST = js.fixed_state([0.0, 0.0])
GUESS = js.Trajectory.from_arrays([0.0, 2.0], np.zeros((2, 2)), np.zeros((2, 1)))


def problem(**changed):
    return dataclasses.replace(double_integrator(ENERGY, FIXED), **changed)


def constrained(function, cone=None, **more):
    return problem(constraints=(js.Constraint(function, js.NonNegative() if cone is None else cone, **more),))


def line(states, controls, nodes=2):
    return js.Trajectory.from_arrays(
        np.linspace(0.0, 2.0, nodes), np.zeros((nodes, states)), np.zeros((nodes, controls))
    )


class Plain(js.Dynamics):
    """Dynamics whose call takes no time."""

    state_size: int = 2
    control_size: int = 1

    def __call__(self, x, u):
        return jnp.append(x[1:], u)


WRONG = {
    # --- shapes ---
    "dynamics of another size": (
        lambda: problem(dynamics=js.Dynamics.of(lambda x, u, t, p: x[:1], 2, 1)),
        GUESS,
        r"dynamics: returns shape \(1,\), expected \(2,\)",
    ),
    "guess with too few states": (
        problem,
        line(1, 1),
        r"guess\.state: expected shape \(5, 2\).*got \(5, 1\)",
    ),
    "guess with too many controls": (problem, line(2, 3), r"guess\.control: expected shape \(5, 1\)"),
    "per-node parameter of another length": (
        lambda: problem(cost=js.Cost(lambda x, u, t, p: p * u @ u, parameters=np.ones(4), per_node=True)),
        GUESS,
        r"cost\.parameters: per_node arrays have the 5 nodes.*\(4,\)",
    ),
    "active of another length": (
        lambda: constrained(lambda x, u, t, p: x, active=np.ones(3, bool), name="box"),
        GUESS,
        r"constraints\[0\] \(box\)\.active: expected flags of shape \(5,\)",
    ),
    "an end of too many components": (
        lambda: problem(boundary=js.Boundary(REST, js.fixed_state([0.0, 0.0, 0.0]))),
        GUESS,
        r"boundary\.final",
    ),
    "a cost that is no number": (
        lambda: problem(cost=js.Cost(lambda x, u, t, p: u**2)),
        GUESS,
        r"cost\.running: returns shape \(1,\), expected \(\).*value\[0\]",
    ),
    # --- NaN ---
    "NaN in a parameter": (
        lambda: problem(cost=js.Cost(lambda x, u, t, p: p["k"] * u @ u, parameters={"k": np.nan})),
        GUESS,
        r"cost\.parameters\['k'\]: holds a value that is not a number",
    ),
    "NaN in the guess": (
        problem,
        eqx.tree_at(lambda g: g.state, GUESS, GUESS.state.at[1, 0].set(jnp.nan)),
        r"guess\.state: holds a value that is NaN",
    ),
    "NaN at an end": (
        lambda: problem(boundary=js.Boundary(REST, js.fixed_state([np.nan, 0.0]))),
        GUESS,
        r"boundary\.final\.parameters: holds a value that is not a number",
    ),
    # --- float32 ---
    "float32 in a parameter": (
        lambda: problem(cost=js.Cost(lambda x, u, t, p: p * u @ u, parameters=np.float32(1.0))),
        GUESS,
        r"cost\.parameters: expected float64, got float32",
    ),
    "float32 in the dynamics": (
        lambda: problem(dynamics=js.Dynamics.of(lambda x, u, t, p: p * x, 2, 1, jnp.ones(2, jnp.float32))),
        GUESS,
        r"dynamics\.parameters: expected float64, got float32",
    ),
    "float32 in the guess": (
        problem,
        jax.tree.map(lambda v: v.astype(jnp.float32), line(2, 1)),
        r"guess\.time: expected float64, got float32",
    ),
    # --- an end outside of the limits ---
    "goal above a state's limit": (
        lambda: problem(constraints=(js.bounds(state=([None, None], [0.5, None])),)),
        GUESS,
        r"boundary\.final: x\[0\] is fixed at 1, outside of 'state bounds', whose limit is 0\.5",
    ),
    "start below a state's limit": (
        lambda: problem(constraints=(js.bounds(state=([0.2, None], [2.0, None])),)),
        GUESS,
        r"boundary\.initial: x\[0\] is fixed at 0, outside",
    ),
    "an empty range of a control": (
        lambda: problem(constraints=(js.bounds(control=(2.0, -2.0)),)),
        GUESS,
        r"control bounds: the range of u\[0\] is empty: lower 2, upper -2",
    ),
    # --- another shape than the cone's ---
    "a scalar for a cone": (
        lambda: constrained(lambda x, u, t, p: x[0]),
        GUESS,
        r"returns shape \(\), but NonNegative\(\) holds one axis.*jnp\.stack\(\[value\]\)",
    ),
    "a matrix for a cone": (
        lambda: constrained(lambda x, u, t, p: jnp.outer(x, x)),
        GUESS,
        r"returns shape \(2, 2\)",
    ),
    "one value for a second-order cone": (
        lambda: constrained(lambda x, u, t, p: x[:1], js.SecondOrder()),
        GUESS,
        r"returns shape \(1,\), but SecondOrder\(\) holds one axis of 2 values or more",
    ),
    "a cone's class": (
        lambda: constrained(lambda x, u, t, p: x, js.NonNegative),
        GUESS,
        r"constraints\[0\]\.cone: expected an instance of Cone, got the class NonNegative",
    ),
    # --- a function that returns no array, or fails ---
    "a list for a derivative": (
        lambda: problem(dynamics=js.Dynamics.of(lambda x, u, t, p: [x[1], u[0]], 2, 1)),
        GUESS,
        r"dynamics: .*returns a list; return one array",
    ),
    "a tuple of values": (lambda: constrained(lambda x, u, t, p: (x[0], x[1])), GUESS, r"returns a tuple"),
    "a condition for a constraint": (
        lambda: constrained(lambda x, u, t, p: x[1:] < 0.5),
        GUESS,
        r"constraints\[0\].*returns booleans; write x < 1 as the number 1 - x",
    ),
    "a condition for a cost": (
        lambda: problem(cost=js.Cost(lambda x, u, t, p: x[0] > 0.0)),
        GUESS,
        r"cost\.running: .*returns booleans",
    ),
    "nothing at all": (
        lambda: problem(cost=js.Cost(lambda x, u, t, p: None)),
        GUESS,
        r"cost\.running: .*returns a NoneType",
    ),
    "an unknown key": (
        lambda: problem(cost=js.Cost(lambda x, u, t, p: p["m"] * u @ u, parameters={"k": 1.0})),
        GUESS,
        r"cost\.running: .*fails.*'m'",
    ),
    "dynamics that take no time": (
        lambda: problem(dynamics=Plain()),
        GUESS,
        r"dynamics: .*fails.*positional argument",
    ),
    # --- time ---
    "an empty range of the final time": (
        lambda: problem(time=js.Time(5, js.FreeTime(4.0, 2.0))),
        GUESS,
        r"time\.final: the range is empty: lower 4 exceeds upper 2",
    ),
    "no time at all": (
        lambda: problem(time=js.Time(5, js.FixedTime(0.0))),
        GUESS,
        r"time\.final\.duration: must be positive and finite, is 0",
    ),
    "an endless final time": (
        lambda: problem(time=js.Time(5, js.FreeTime(1.0, np.inf))),
        GUESS,
        r"time\.final: the upper limit must be finite",
    ),
    "a dilation that reaches no final time": (
        lambda: problem(time=js.Time(5, js.FreeTime(1.0, 2.0, dilation=(3.0, 4.0)))),
        GUESS,
        r"no final time in its range can be reached with this dilation",
    ),
    "a mesh that is paid for": (
        lambda: problem(time=js.Time(5, js.FreeTime(1.0, 2.0), mesh_weight=-1e-3)),
        GUESS,
        r"time\.mesh_weight: must be finite and not negative, is -0\.001",
    ),
    "a mesh without a unit": (
        lambda: problem(time=js.Time(5, js.FreeTime(1.0, 2.0), mesh_unit=0.0)),
        GUESS,
        r"time\.mesh_unit: must be positive and finite, is 0",
    ),
    "a unit of the mesh for each node": (
        lambda: problem(time=js.Time(5, js.FreeTime(1.0, 2.0), mesh_unit=np.ones(5))),
        GUESS,
        r"time\.mesh_unit: expected one number, got shape \(5,\)",
    ),
    "one node": (
        lambda: problem(time=js.Time(1, js.FixedTime(2.0))),
        GUESS,
        r"time\.nodes: expected a whole number, 2 or more, got 1",
    ),
    # --- what the solver does not do, by name ---
    "several phases": (
        lambda: [problem(), problem()],
        GUESS,
        r"2 problems were given\. Several phases are not joined",
    ),
    "a path equality": (
        lambda: constrained(lambda x, u, t, p: x[:1], js.Zero(), name="rail"),
        GUESS,
        r"rail: equality constraints on the path are not supported",
    ),
    "a second-order constraint that is not convex": (
        lambda: constrained(lambda x, u, t, p: jnp.stack([x[0] ** 2, x[1]]), js.SecondOrder(), name="dish"),
        GUESS,
        r"dish: a constraint that is not convex must be of cone NonNegative\(\)",
    ),
    "a soft equality": (
        lambda: constrained(lambda x, u, t, p: x[:1], js.Zero(), soft=1.0, convex=True, name="rail"),
        GUESS,
        r"rail: a soft constraint must be an inequality",
    ),
    # --- other parts ---
    "a constraint without its comma": (
        lambda: problem(constraints=js.bounds(control=(-9.0, 9.0))),
        GUESS,
        r"constraints: expected a tuple, got a Constraint\. A tuple of one needs a comma",
    ),
    "a function for a constraint": (
        lambda: problem(constraints=(lambda x, u, t, p: x,)),
        GUESS,
        r"constraints\[0\]: expected an instance of Constraint, got a function",
    ),
    "one number for a pair of limits": (
        lambda: problem(constraints=(js.bounds(control=1.0),)),
        GUESS,
        r"bounds: control takes a pair \(lower, upper\), got 1\.0",
    ),
    "a weight for each row": (
        lambda: constrained(lambda x, u, t, p: x, soft=[1.0, 2.0], convex=True),
        GUESS,
        r"\.soft: expected one number",
    ),
    "a broken number of nodes": (
        lambda: problem(time=js.Time(10.0, js.FixedTime(2.0))),
        GUESS,
        r"time\.nodes: expected a whole number",
    ),
    "an infinite size": (
        lambda: problem(scale=js.Scale(state=[np.inf, 1.0], control=[1.0], time=1.0)),
        GUESS,
        r"scale\.state: sizes must be positive and finite",
    ),
    "two constraints of one name": (
        lambda: problem(constraints=(js.bounds(control=(-1.0, 1.0)), js.bounds(control=(-2.0, 2.0)))),
        GUESS,
        r"the name 'control bounds' occurs 2 times",
    ),
    "a word for a parameter": (
        lambda: problem(cost=js.Cost(lambda x, u, t, p: u @ u, parameters={"mode": "fast"})),
        GUESS,
        r"cost\.parameters\['mode'\]: holds a str; parameters are numbers and arrays",
    ),
    "arrays for a guess": (
        problem,
        np.zeros((5, 2)),
        r"guess: expected a Trajectory or a Solution, got a ndarray",
    ),
    "a number for a final time": (
        lambda: problem(time=js.Time(5, 2.0)),
        GUESS,
        r"time\.final: expected an instance of FreeTime or FixedTime, got a float",
    ),
    "a function for dynamics": (
        lambda: problem(dynamics=lambda x, u, t, p: x),
        GUESS,
        r"dynamics: expected an instance of Dynamics, got a function\. Dynamics\.of\(function",
    ),
    "a function for a cost": (
        lambda: problem(cost=lambda x, t, p: t),
        GUESS,
        r"cost: expected an instance of Cost, got a function\. Cost\(running=\.\.\.\) or Cost\(terminal=",
    ),
    "a pair for a boundary": (
        lambda: problem(boundary=([0.0, 0.0], [1.0, 0.0])),
        GUESS,
        r"boundary: expected an instance of Boundary, got a tuple\. Boundary\(fixed_state",
    ),
    "a list for an end": (
        lambda: problem(boundary=js.Boundary([0.0, 0.0], REST)),
        GUESS,
        r"boundary\.initial: expected an instance of EndCondition, got a list\. fixed_state",
    ),
    "an end for coupled ends": (
        lambda: problem(boundary=js.Boundary(REST, REST, coupled=REST)),
        GUESS,
        r"boundary\.coupled: expected an instance of CoupledEnds or None",
    ),
    "a number for a time": (
        lambda: problem(time=2.0),
        GUESS,
        r"time: expected an instance of Time, got a float\. Time\(nodes=30, final=FixedTime",
    ),
    "a number for a scale": (
        lambda: problem(scale=10.0),
        GUESS,
        r"scale: expected an instance of Scale or None, got a float\. Scale\(state=",
    ),
    "a fraction for a control's number": (
        lambda: problem(zero_order_hold=(0.5,)),
        GUESS,
        r"zero_order_hold: expected a whole number, 0 or more, got 0\.5",
    ),
    "an array of NumPy in the dynamics": (
        lambda: problem(dynamics=js.Dynamics.of(lambda x, u, t, p: np.array([x[1], u[0]]), 2, 1)),
        GUESS,
        r"dynamics: .*Call jnp, not np; in place of if, and, or, call jnp\.where",
    ),
    "a choice in the dynamics": (
        lambda: problem(dynamics=js.Dynamics.of(lambda x, u, t, p: x if x[0] > 0.0 else -x, 2, 1)),
        GUESS,
        r"dynamics: .*call jnp\.where",
    ),
    "a scale of another size": (
        lambda: problem(scale=js.Scale(state=[1.0], control=[1.0], time=1.0)),
        GUESS,
        r"scale\.state: expected shape \(2,\), got \(1,\)",
    ),
    "a negative weight": (
        lambda: constrained(lambda x, u, t, p: x, soft=-1.0, convex=True, name="speed"),
        GUESS,
        r"speed: soft, the weight, must not be negative or infinite, is -1",
    ),
    "a control that does not exist": (
        lambda: problem(zero_order_hold=(1,)),
        GUESS,
        r"zero_order_hold: control 1 does not exist; dynamics has 1",
    ),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_wrong_request(wrong):
    make, guess, message = WRONG[wrong]
    with pytest.raises(js.InvalidProblem, match=f"(?s){message}"):
        js.solve(make(), guess)


@pytest.mark.parametrize("method", [js.NewtonSCP, "NewtonSCP"])
def test_a_method_that_is_none(method):
    with pytest.raises(js.InvalidProblem, match="method: expected an instance of Method, got"):
        js.solve(problem(), GUESS, method)


@pytest.mark.parametrize(("field", "value"), [("time", 2.0), ("boundary", ([0.0], [1.0])), ("cost", None)])
def test_a_straight_line_names_a_part_of_another_class(field, value):
    with pytest.raises(js.InvalidProblem, match=f"^{field}: expected an instance of"):
        js.straight_line(problem(**{field: value}))


@pytest.mark.parametrize(
    ("argument", "value"), [("final_time", "2"), ("final_time", [2.0]), ("control", "hover"), ("control", {})]
)
def test_a_straight_line_names_an_argument_that_is_no_number(argument, value):
    with pytest.raises(js.InvalidProblem, match=f"^{argument}: expected"):
        js.straight_line(problem(), **{argument: value})


def test_straight_line_needs_ends_that_are_given():
    ends = js.Boundary(REST, js.EndCondition(lambda x, t, p: x, rows=(js.EndRows("dock", count=2),)))
    with pytest.raises(js.InvalidProblem, match=r"boundary\.final: dock are given by a function"):
        js.straight_line(problem(boundary=ends))


def steep(x, u, t, p):
    return jnp.linalg.norm(u)


@jax.custom_jvp
def wrong_square(u):
    return u @ u


wrong_square.defjvp(lambda primals, tangents: (wrong_square(*primals), primals[0] @ tangents[0]))


@pytest.mark.parametrize(
    ("cost", "message"),
    [
        (steep, r"cost\.running: its derivative at node 0 of the guess is not finite"),
        (lambda x, u, t, p: jnp.log(x[0] - 1.0), r"cost\.running: its value at node 0"),
        (lambda x, u, t, p: wrong_square(u + 1.0), r"cost\.running: its derivative differs from differences"),
    ],
    ids=["no derivative", "no value", "wrong derivative"],
)
def test_functions_are_checked_on_request(cost, message):
    asked = problem(cost=js.Cost(running=cost))
    with pytest.raises(js.InvalidProblem, match=message):
        js.solve(asked, js.straight_line(asked), check=True)


@pytest.mark.nightly
def test_an_invalid_element_of_a_batch_is_undefined_and_disturbs_no_other():
    """NaN in every float; the others equal single calls."""

    def energy(duration):
        asked = double_integrator(ENERGY, js.Time(5, js.FixedTime(duration)))
        return js.solve(asked, GUESS)

    batch = jax.vmap(energy)(jnp.array([2.0, jnp.nan, 1.0]))
    assert list(js.status_names(batch.status)) == ["converged", "invalid_input", "converged"]
    floats = [v for v in jax.tree.leaves(batch) if jnp.issubdtype(v.dtype, jnp.inexact)]
    assert all(np.all(np.isnan(v[1])) for v in floats)
    np.testing.assert_allclose(batch.cost[jnp.array([0, 2])], [1.5, 12.0], rtol=1e-5)
    assert float(js.best(batch).cost) == float(batch.cost[0])
    gradient = jax.vmap(jax.grad(lambda t: energy(t).cost))(jnp.array([2.0, jnp.nan]))
    assert np.isfinite(gradient[0])
    assert np.isnan(gradient[1])


@pytest.mark.slow
def test_numbers_are_taken_as_python_numpy_and_jax_make_them():
    costs = []
    for two in (2.0, 2, np.float64(2.0), np.array(2.0), jnp.array(2.0), np.int64(2)):
        asked = double_integrator(
            js.Cost(lambda x, u, t, p: p * u @ u, parameters=two), js.Time(5, js.FixedTime(two)), goal=two
        )
        costs.append(float(js.solve(asked, js.straight_line(asked)).cost))
    np.testing.assert_allclose(costs, 2.0 * 12.0 * 4.0 / 8.0, rtol=1e-5)


@pytest.mark.slow
def test_an_empty_range_in_a_batch_is_invalid():
    def fastest(longest):
        asked = double_integrator(
            js.Cost(terminal=time_taken), js.Time(5, js.FreeTime(1.0, longest)), limit=2.0
        )
        return js.solve(asked, GUESS).status

    assert list(js.status_names(jax.vmap(fastest)(jnp.array([0.5])))) == ["invalid_input"]
    assert FREE.nodes == 5
