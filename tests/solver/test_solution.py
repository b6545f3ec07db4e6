"""Texts of a solution, and the backends that served."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.scipy.special import erf

import jaxscp as js
from jaxscp.backends.libraries import INTEGRATION, INTERIOR_POINT
from tests.support.own_problems import double_integrator, squared_control

ENERGY = js.Cost(running=squared_control)
FIXED = js.Time(5, js.FixedTime(2.0))


@pytest.fixture(scope="module")
def solution():
    problem = double_integrator(ENERGY, FIXED)
    return js.solve(problem, js.straight_line(problem))


def served(solution):
    return solution.backends.report()


def test_it_says_which_backend_served(solution):
    integration, conic = (
        "C++" if library.available() else "JAX" for library in (INTEGRATION, INTERIOR_POINT)
    )
    assert served(solution) == f"integration: {integration}; conic step: {conic}"


@pytest.mark.nightly
def test_an_operation_without_compiled_code_is_served_by_jax_with_a_warning():
    if not INTEGRATION.available():
        pytest.skip("compiled code is not installed")
    dynamics = js.Dynamics.of(lambda x, u, t, p: jnp.array([x[1] + erf(x[1]), u[0]]), states=2, controls=1)
    problem = js.OptimalControlProblem(
        dynamics, ENERGY, js.Boundary(js.fixed_state([0.0, 0.0]), js.fixed_state([1.0, 0.0])), FIXED
    )
    with pytest.warns(js.PerformanceWarning, match="the operation erf"):
        found = js.solve(problem, js.straight_line(problem))
    assert served(found).startswith("integration: JAX")


def test_the_table_has_a_line_an_iteration_and_one_for_the_optimum(solution):
    lines = solution.iteration_table().splitlines()
    assert len(lines) == 2 + int(solution.iterations)
    assert lines[-1].split() == [
        "optimum",
        f"{float(solution.cost):.4f}",
        "2.000",
        f"{float(solution.certificate.defect):.1e}",
        str(int(solution.interior_point_iterations)),
    ]


def test_its_text_has_status_cost_and_certificate(solution):
    text = str(solution)
    assert text.startswith(f"converged: cost {float(solution.cost):.6g}, final time 2")
    assert solution.certificate.report() in text


def test_the_text_of_a_batch_counts_statuses(solution):
    other = js.Status.infeasible
    batch = jax.tree.map(lambda *v: jnp.stack(v), *[solution] * 3)
    status = jax.vmap(js.Status.where, (0, 0, None))(jnp.array([True, False, True]), batch.status, other)
    text = str(eqx.tree_at(lambda s: s.status, batch, status))
    assert "3 solutions" in text
    assert "2 converged" in text
    assert "1 infeasible (element 1): The constraints of a convex subproblem" in text
    with pytest.raises(ValueError, match="a batch has no table"):
        batch.iteration_table()


def with_statuses(solution, *statuses):
    """A batch of elements that are alike, on the host, as ``Planner.map`` returns it."""
    found = [eqx.tree_at(lambda s: s.status, solution, status) for status in statuses]
    return jax.device_get(jax.tree.map(lambda *v: jnp.stack(v), *found))


def test_an_invalid_element_says_how_to_learn_why(solution):
    batch = with_statuses(solution, js.Status.converged, js.Status.invalid_input)
    text = jax.tree.map(lambda v: v[1], batch).report()
    assert text.startswith("invalid_input: no plan was made")
    assert "jaxscp.solve(problem, guess)" in text
    assert "nan" not in text
    assert "1 invalid_input (element 1): The problem or its guess" in batch.report()
    assert jax.tree.map(lambda v: v[0], batch).report().startswith("converged: cost")


@pytest.mark.parametrize(
    "name", ["infeasible", "insufficient_progress", "dynamics_unmet", "constraints_unmet"]
)
def test_a_text_speaks_of_corridors_to_landings_alone(solution, name):
    own = eqx.tree_at(lambda s: s.status, solution, getattr(js.Status, name))
    places = jnp.zeros(own.trajectory.nodes - 1, int)
    landing = eqx.tree_at(lambda s: s.context, own, places, is_leaf=lambda v: v is None)
    assert "corridor" in landing.report()
    for text in (own.report(), with_statuses(own, own.status, js.Status.converged).report()):
        assert name in text
        assert not any(word in text for word in ("corridor", "landing", "flight", "keep-out"))


class Hindered(eqx.Module):
    """A scenario that knows what hinders its plans."""

    cause: jax.Array

    def hindrance(self, plan):
        return f"the deck {float(self.cause):g}"

    def replan_doubt(self, plan, elapsed):
        return ""


def test_a_scenario_tells_what_hindered_its_plan(solution):
    limit = js.Status.iteration_limit
    assert "the deck 1" in eqx.tree_at(lambda s: s.status, solution, limit).report(Hindered(jnp.array(1.0)))
    assert "deck" not in solution.report(Hindered(jnp.array(1.0)))  # it converged
    causes = with_statuses(solution, js.Status.converged, limit).cause(Hindered(jnp.array([1.0, 2.0])))
    assert causes[0] == ""
    assert causes[1].startswith("the deck 2")


def test_a_final_time_at_its_limit_is_told(solution):
    failed = eqx.tree_at(lambda s: s.status, solution, js.Status.insufficient_progress)
    last = float(failed.final_time)
    short, wide, fixed = (
        js.Time(5, f) for f in (js.FreeTime(0.1, last), js.FreeTime(0.1, 9.0 * last), js.FixedTime(last))
    )
    assert failed.cause(double_integrator(ENERGY, short)).startswith("the final time is at its upper limit")
    for free in (wide, fixed):
        assert "the final time is" not in failed.cause(double_integrator(ENERGY, free))


def test_the_causes_of_a_batch_are_those_of_its_elements(solution):
    off = eqx.tree_at(lambda s: s.certificate.end_errors, solution, solution.certificate.end_errors + 1.0)
    batch = with_statuses(off, js.Status.converged, js.Status.iteration_limit)
    causes = batch.cause()
    assert causes.shape == (2,)
    assert causes.tolist() == [jax.tree.map(lambda v, i=i: v[i], batch).cause() for i in range(2)]
    assert causes[0] == ""
    assert causes[1].startswith("largest violation: final position, off by 1")
    twice = jax.tree.map(lambda v: np.stack([v] * 3), batch)
    assert twice.cause().shape == (3, 2)


def test_sizes_that_differ_much_ask_for_a_scale(solution):
    """The thrust of a rocket beside its gimbal's angle: a problem with a scale has other node variables."""
    rocket = eqx.tree_at(
        lambda s: (s.trajectory.control, s.status),
        solution,
        (2e4 * jnp.ones_like(solution.trajectory.control), js.Status.iteration_limit),
    )
    assert "sizes differ much (u[0] up to 2e+04, x[1] up to" in rocket.cause()
    assert "scale=jaxscp.Scale(state=" in rocket.cause()
    assert "scale=" not in eqx.tree_at(lambda s: s.z, rocket, 2.0 * rocket.z).cause()
    assert "scale=" not in eqx.tree_at(lambda s: s.status, solution, js.Status.iteration_limit).cause()


def test_its_text_under_a_transformation_is_its_structure(solution):
    texts = []
    jax.eval_shape(lambda s: texts.append(str(s)) or s.cost, solution)
    assert texts[0].startswith("Solution(")
    assert str(jax.tree.map(lambda v: None, solution)).startswith("Solution(")


# --- between the nodes, and in files ---

STATE_ERROR = 1e-7  # of the optimum
CONTROL_ERROR = 1e-5  # the cost is flat there, so that controls are known less well


def test_its_trajectory_is_known_between_the_nodes(solution):
    """Least energy from rest to rest: x = 3 (t / T)^2 - 2 (t / T)^3, with a control that is linear in time."""
    samples = solution.trajectory.sample(rate=10)
    part = np.asarray(samples.time) / 2.0
    assert len(part) == 21
    np.testing.assert_allclose(samples.state[:, 0], 3.0 * part**2 - 2.0 * part**3, atol=STATE_ERROR)
    np.testing.assert_allclose(samples.state_rate[:, 1], 1.5 - 3.0 * part, atol=CONTROL_ERROR)
    assert not isinstance(samples, js.FlightSamples)


def assert_same(found, expected):
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)


def test_a_saved_solution_is_loaded_bitwise(solution, tmp_path):
    solution.save(tmp_path / "plan")  # the name stays as it is
    assert_same(js.Solution.load(tmp_path / "plan"), solution)


def test_a_saved_batch_is_loaded_bitwise(solution, tmp_path):
    batch = jax.tree.map(lambda *v: jnp.stack(v), *[solution] * 3)
    status = jax.vmap(js.Status.where, (0, 0, None))(
        jnp.array([True, False, True]), batch.status, js.Status.infeasible
    )
    batch = eqx.tree_at(lambda s: s.status, batch, status)
    batch.save(tmp_path / "batch.npz")
    found = js.Solution.load(tmp_path / "batch.npz")
    assert_same(found, batch)
    assert js.status_names(found.status).tolist() == ["converged", "infeasible", "converged"]


def test_what_cannot_be_integrated_is_saved_too(solution, tmp_path):
    """Infinite and undefined numbers, and a solution without multipliers."""
    odd = eqx.tree_at(
        lambda s: (s.cost, s.certificate.defect), solution, (jnp.array(jnp.nan), jnp.array(jnp.inf))
    )
    odd = eqx.tree_at(lambda s: s.multipliers, odd, None)
    odd.save(tmp_path / "odd.npz")
    assert_same(js.Solution.load(tmp_path / "odd.npz"), odd)


def test_dynamics_of_the_user_are_left_out_of_a_file(solution, tmp_path):
    own = js.Dynamics.of(lambda x, u, t, p: jnp.stack([x[1], u[0]]), 2, 1)
    theirs = eqx.tree_at(lambda s: s.trajectory, solution, solution.trajectory.with_dynamics(own))
    theirs.save(tmp_path / "plan.npz")
    found = js.Solution.load(tmp_path / "plan.npz").trajectory
    with pytest.raises(ValueError, match=r"trajectory\.with_dynamics\(problem\.dynamics\)"):
        found.sample(rate=10)
    again, expected = found.with_dynamics(own).sample(rate=10), solution.trajectory.sample(rate=10)
    np.testing.assert_allclose(again.state, expected.state, rtol=0, atol=1e-12)


def test_a_saved_solution_is_a_guess_and_is_certified(solution, tmp_path):
    solution.save(tmp_path / "plan.npz")
    found, problem = js.Solution.load(tmp_path / "plan.npz"), double_integrator(ENERGY, FIXED)
    assert_same(js.solve(problem, found), js.solve(problem, solution))
    certificate = js.certify(problem, found.trajectory)
    assert certificate.end_names == solution.certificate.end_names
    np.testing.assert_allclose(certificate.end_errors, solution.certificate.end_errors, rtol=0, atol=1e-12)
    assert bool(certificate.passed())


def test_a_context_of_another_kind_is_named(solution, tmp_path):
    odd = eqx.tree_at(lambda s: s.context, solution, print, is_leaf=lambda v: v is None)
    with pytest.raises(TypeError, match=r"solution\.context: a builtin_function_or_method cannot be saved"):
        odd.save(tmp_path / "odd.npz")


def test_the_best_of_a_list_is_the_cheapest_that_converged(solution):
    dear = eqx.tree_at(lambda s: s.cost, solution, solution.cost + 1.0)
    failed = eqx.tree_at(
        lambda s: (s.cost, s.status), solution, (solution.cost - 1.0, js.Status.insufficient_progress)
    )
    assert float(js.best([dear, failed, solution]).cost) == float(solution.cost)


def test_where_none_converged_the_first_one_tells(solution):
    failed = eqx.tree_at(lambda s: s.status, solution, js.Status.dynamics_unmet)
    invalid = eqx.tree_at(
        lambda s: (s.status, s.cost), solution, (js.Status.invalid_input, jnp.array(jnp.nan))
    )
    assert js.status_names(js.best([failed, invalid, failed]).status) == "dynamics_unmet"


def test_the_best_says_what_it_expects(solution):
    with pytest.raises(ValueError, match="put single solutions in a list"):
        js.best(solution)
    with pytest.raises(ValueError, match="expected single solutions in a sequence"):
        js.best([])
    stack = jax.tree.map(lambda v: v[None, None], solution)
    with pytest.raises(ValueError, match="expected one leading axis, got 2"):
        js.best(stack)
