"""Many scenarios by one program: each has the plan that a call makes, whatever the threads and batches."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import equinox as eqx
import jax
import numpy as np
import pytest

import jaxscp
from jaxscp.core.errors import InvalidScenario

SCENARIO = jaxscp.scenarios.ascent_to_platform()
PLANNER = jaxscp.Planner(nodes=10, method=jaxscp.PTR(max_iterations=2))
MASSES = np.array([0.9, 0.95, np.nan, 1.0, 1.05])
ACCURACY = 1e-5  # of the last subproblem, a coarse one: a batch is another program, and its roundings differ


def with_mass(mass):
    return eqx.tree_at(lambda s: s.airframe.body.mass, SCENARIO, mass)


def stack(masses):
    return jax.tree.map(lambda *v: np.stack(v), *map(with_mass, masses))


@pytest.fixture(scope="module")
def plans():
    """Plans by calls; the scenario without a mass is not valid."""
    with pytest.raises(InvalidScenario, match="mass"):
        PLANNER(with_mass(MASSES[2]))
    return [None if np.isnan(mass) else PLANNER(with_mass(mass)) for mass in MASSES]


def assert_same(found, plans, tolerance=0.0):
    assert jaxscp.status_names(found.status)[2] == "invalid_input"
    assert np.isnan(found.z[2]).all()
    assert np.isnan(found.cost[2])
    for i, plan in enumerate(plans):
        if plan is not None:
            alone = jax.tree.map(lambda v, i=i: v[i], found)
            compare = lambda a, b: np.testing.assert_allclose(a, b, rtol=tolerance, atol=tolerance)  # noqa: E731
            jax.tree.map(compare, alone, jax.device_get(plan))


def test_a_scenario_is_checked_in_a_call_of_a_known_program_too(plans):
    """There the check runs beside the plan."""
    with pytest.raises(InvalidScenario, match="mass"):
        PLANNER(with_mass(-1.0))
    with pytest.raises(InvalidScenario, match="mass"):
        PLANNER(with_mass(np.ones(2)))
    with jax.debug_nans(True), pytest.raises(InvalidScenario, match="mass"):
        PLANNER(with_mass(np.nan))


def test_threads_may_call_one_planner(plans):
    with ThreadPoolExecutor(3) as pool:
        found = list(pool.map(PLANNER, [with_mass(mass) for mass in MASSES[[0, 1, 3, 4]]]))
    for plan, same in zip([plan for plan in plans if plan is not None], found, strict=True):
        np.testing.assert_array_equal(plan.z, same.z)


@pytest.mark.parametrize("workers", [None, 1, 3])
def test_each_plan_is_that_of_a_call_for_any_number_of_threads(plans, workers):
    found = PLANNER.map(stack(MASSES), workers=workers)
    assert isinstance(found.cost, np.ndarray)
    assert_same(found, plans)


def test_scenarios_may_come_one_by_one(plans):
    assert_same(PLANNER.map(with_mass(mass) for mass in MASSES), plans)


def test_the_first_of_a_list_may_be_invalid(plans):
    """It gives the shapes alone."""
    found = PLANNER.map([with_mass(mass) for mass in (np.nan, -1.0, MASSES[0])])
    assert list(jaxscp.status_names(found.status))[:2] == ["invalid_input"] * 2
    np.testing.assert_array_equal(found.cost[2], plans[0].cost)


def test_progress_and_what_is_kept(plans):
    calls = []
    keep = lambda solutions: (solutions.final_time, solutions.cost)  # noqa: E731
    times, costs = PLANNER.map(stack(MASSES), keep=keep, progress=lambda *numbers: calls.append(numbers))
    assert calls == [(i + 1, len(MASSES)) for i in range(len(MASSES))]
    assert times.shape == costs.shape == MASSES.shape
    PLANNER.map((with_mass(mass) for mass in MASSES[:2]), progress=lambda *numbers: calls.append(numbers))
    assert calls[-2:] == [(1, None), (2, None)]


@pytest.mark.slow
@pytest.mark.parametrize("size", [2, 8])
def test_batches_have_the_same_plans(plans, size):
    """The last batch is not full; or the only one."""
    assert_same(PLANNER.map(stack(MASSES), batch_size=size), plans, ACCURACY)


@pytest.mark.parametrize(
    ("scenarios", "words"),
    [
        (lambda: SCENARIO, "scenarios: expected a leading axis"),
        (
            lambda: eqx.tree_at(lambda s: s.cone_angle, stack(MASSES), 1.0),
            r"scenarios\.cone_angle: a leading axis of 5",
        ),
        (lambda: [], "there are none"),
        (lambda: [SCENARIO, jaxscp.scenarios.platform_to_platform()], r"scenarios\[1\]: .*corridor"),
        (lambda: iter([3, SCENARIO]), r"scenarios\[0\]: expected a scenario, got a int"),
        (lambda: iter([SCENARIO, 3]), r"scenarios\[1\]: expected a scenario, got a int"),
    ],
)
def test_wrong_scenarios_are_refused_by_name(plans, scenarios, words):
    with pytest.raises(InvalidScenario, match=words):
        PLANNER.map(scenarios())


def test_wrong_numbers_are_refused_by_name():
    with pytest.raises(ValueError, match="batch_size: expected a whole number"):
        PLANNER.map(stack(MASSES), batch_size=0)
    with pytest.raises(ValueError, match="workers: expected a whole number"):
        PLANNER.map(stack(MASSES), workers=0)
    with pytest.raises(ValueError, match="multiple of the number of devices"):
        PLANNER.map(stack(MASSES), batch_size=3, devices=tuple(jax.devices()) * 2)


@pytest.mark.usefixtures("no_type_checks")
def test_arguments_of_another_class_are_refused_by_name():
    for name, value in (("keep", 5), ("progress", "bar"), ("devices", "cpu"), ("devices", ("cpu",))):
        with pytest.raises(ValueError, match=f"^{name}: expected"):
            PLANNER.map(stack(MASSES), **{name: value})
    for name, value in (("nodes", "30"), ("nodes", 1), ("method", "paper"), ("samples", 2.5)):
        with pytest.raises(InvalidScenario, match=f"^{name}: expected"):
            jaxscp.Planner(**{name: value})


ON_TWO_DEVICES = """
import jax, numpy as np
jax.config.update("jax_enable_x64", True)
from tests.planner.test_map import PLANNER, MASSES, stack
found = PLANNER.map(stack(MASSES), batch_size=4, devices=tuple(jax.devices()))
print(*found.cost)
"""


@pytest.mark.nightly
def test_devices_share_a_batch(plans):
    settings = {"XLA_FLAGS": "--xla_force_host_platform_device_count=2", "JAX_PLATFORMS": "cpu"}
    done = subprocess.run(
        [sys.executable, "-c", ON_TWO_DEVICES],
        env=os.environ | settings,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    costs = [np.nan if plan is None else float(plan.cost) for plan in plans]
    np.testing.assert_allclose(np.array(done.stdout.split(), float), costs, rtol=ACCURACY)
