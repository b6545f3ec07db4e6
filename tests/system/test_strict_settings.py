"""JAX's strict settings: no broadcast between ranks, and no promotion of dtypes, throughout a plan."""

import os
import subprocess
import sys

import pytest

PROGRAM = """
import equinox as eqx, jax, jax.numpy as jnp, jaxscp
jax.config.update("jax_enable_x64", True)
scenario = jaxscp.scenarios.ascent_to_platform()
for method in (jaxscp.NewtonSCP(), jaxscp.PTR()):
    planner = jaxscp.Planner(nodes=12, method=method)
    plan = planner(scenario)
    assert jaxscp.status_names(plan.status) == "converged", plan.report()
    assert plan.certificate.passed(method.holds_between_nodes)
    assert jaxscp.status_names(planner.replan(plan, scenario).status) == "converged"
planner = jaxscp.Planner(nodes=12)
cost = lambda mass: planner(eqx.tree_at(lambda s: s.airframe.body.mass, scenario, mass)).cost
print("slope", float(jax.grad(cost)(jnp.array(0.9))))
"""


@pytest.mark.nightly
@pytest.mark.slow
def test_a_plan_keeps_to_strict_settings():
    strict = {"JAX_NUMPY_RANK_PROMOTION": "raise", "JAX_NUMPY_DTYPE_PROMOTION": "strict"}
    run = subprocess.run(
        [sys.executable, "-c", PROGRAM], env=os.environ | strict, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    assert float(run.stdout.rsplit("slope", 1)[1]) > 0.0
