"""Known obstacles: a plan whose hull touches one is not converged, in a call, a re-plan, a batch and a file."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp import monte_carlo as mc
from jaxscp.corridor import box, connect, obstacles_near

PLANNER = jaxscp.Planner(nodes=15)
WALL = np.stack(np.meshgrid([3.0], np.arange(-2.0, 1.01, 0.1), np.arange(0.0, 3.01, 0.1)), axis=-1).reshape(
    -1, 3
)
KNOWN = 0.3  # m
RADIUS = 0.076  # m, of the paper's vehicle


def scenario(least):
    """A flight past the edge of a wall, y = 1 m, in a corridor that begins at y = ``least`` beside the wall."""
    rooms = [box([-1, -2, 0], [2.9, 3, 3]), box([2.0, least, 0], [4.0, 3, 3]), box([3.1, -2, 0], [7, 3, 3])]
    corridor = connect(rooms)
    near = obstacles_near(corridor, WALL, KNOWN, size=1024)
    ends = jaxscp.at_rest([0.0, 0.0, 1.0]), jaxscp.at_rest([6.0, 0.0, 1.0])
    return jaxscp.scenarios.through(corridor, *ends, near_obstacles=near)


def status(solution):
    return jaxscp.status_names(solution.status)


@pytest.mark.nightly
def test_a_plan_whose_hull_touches_an_obstacle_is_not_converged():
    touching, clear = (PLANNER(scenario(least)) for least in (1.0, 1.0 + RADIUS + 0.002))
    assert status(touching) == "verification_failed"
    assert "clearance" in touching.cause()
    assert status(clear) == "converged"
    assert 0.0 < float(clear.certificate.clearance) < 0.05
    assert "from the hull to obstacles" in str(clear)
    again = PLANNER.replan(clear, scenario(1.0))
    assert status(again) == "verification_failed"
    # the distance by SciPy, on lines between dense samples of the path
    from scipy.spatial import KDTree

    path = touching.trajectory.sample(rate=2000).state[:, :3]
    nearest = KDTree(WALL).query(np.asarray(path))[0].min() - RADIUS
    assert float(touching.certificate.clearance) == pytest.approx(nearest, abs=2e-3)


@pytest.mark.slow
def test_a_sweep_has_the_clearance_of_every_case(tmp_path):
    mass = mc.Parameter("airframe.body.mass", mc.Uniform(0.8, 1.0))
    study = mc.Study(PLANNER, scenario(1.2), [mass], mc.Sobol(2, 1))
    sweep = mc.sweep(study, tmp_path / "sweep")
    expected = [float(PLANNER(study.case(number)).certificate.clearance) for number in range(2)]
    assert sweep.values("clearance").tolist() == expected
    assert sweep.layout.quantities["clearance"].unit == "m"


@pytest.mark.nightly
def test_known_obstacles_change_no_number_of_a_plan():
    known = scenario(1.2)
    unknown = dataclasses.replace(known, near_obstacles=None)
    first, second = PLANNER(known), PLANNER(unknown)
    assert second.certificate.clearance is None
    np.testing.assert_array_equal(first.z, second.z)


@pytest.mark.nightly
def test_known_obstacles_under_transformations_and_in_files(tmp_path):
    scenarios = [scenario(least) for least in (1.0, 1.2)]
    batch = jax.vmap(PLANNER)(jax.tree.map(lambda *leaves: jnp.stack(leaves), *scenarios))
    assert list(status(batch)) == ["verification_failed", "converged"]
    assert "(element 0)" in batch.certificate.report()

    def cost(mass):
        return PLANNER(eqx.tree_at(lambda s: s.airframe.body.mass, scenarios[1], mass)).cost

    assert float(jax.grad(cost)(jnp.array(0.928))) > 0.0
    plan = PLANNER(scenarios[1])
    plan.save(tmp_path / "plan.npz", scenarios[1])
    kept, asked = (of.load(tmp_path / "plan.npz") for of in (jaxscp.Solution, jaxscp.LandingScenario))
    assert float(kept.certificate.clearance) == float(plan.certificate.clearance)
    hull = asked.hull(kept.context)
    problem, _ = asked.problem(15, context=kept.context)
    again = jaxscp.certify(problem, kept.trajectory, hull=hull)
    assert float(again.clearance) == pytest.approx(float(plan.certificate.clearance), abs=1e-9)
    PLANNER.export(tmp_path / "planner.jaxscp", scenarios[0])
    loaded = jaxscp.load(tmp_path / "planner.jaxscp")
    assert [status(loaded(s)) for s in scenarios] == ["verification_failed", "converged"]
