"""Why a case is invalid, in the summary of a folder that was written by hand: nothing compiles."""

import numpy as np
import pytest

import jaxscp
from jaxscp import monte_carlo as mc
from jaxscp.core.status import STATUS_NAMES
from jaxscp.monte_carlo.outcome import Quantity
from jaxscp.monte_carlo.storage import Layout, Store

CONVERGED, INVALID = (STATUS_NAMES.index(name) for name in ("converged", "invalid_input"))


def landing():
    parameters = (mc.Parameter("airframe.body.mass", mc.Choice((1.0, 40.0)), "mass", "kg"),)
    return mc.Study(jaxscp.Planner(), jaxscp.scenarios.ascent_to_platform(), parameters, mc.Grid((2,)))


def own_problem():
    problem = jaxscp.OptimalControlProblem(
        dynamics=jaxscp.DoubleIntegrator(1),
        cost=jaxscp.Cost(running=lambda x, u, t, p: u @ u),
        constraints=(jaxscp.bounds(control=(-5.0, 5.0)),),
        boundary=jaxscp.Boundary(jaxscp.fixed_state([0.0, 0.0]), jaxscp.fixed_state([1.0, 0.0])),
        time=jaxscp.Time(nodes=11, final=jaxscp.FreeTime(1.0, 5.0)),
    )
    parameters = (mc.Parameter("time.final.lower", mc.Choice((1.0, 9.0)), "shortest", "s"),)
    return mc.Study(mc.Solves(jaxscp.straight_line(problem, 3.0)), problem, parameters, mc.Grid((2,)))


def stored(study, folder):
    """Results of two cases, of which the second one is invalid."""
    store, numbers = Store(folder), np.arange(2)
    quantities = {"success": Quantity("bool", (), "", False), "status": Quantity("int32", (), "", False)}
    store.create(study.identity(), Layout(2, 2, {study.names[0]: ""}, quantities))
    values = {study.names[0]: study.values(numbers)[:, 0], "success": numbers == 0}
    values["status"] = np.where(numbers == 0, CONVERGED, INVALID).astype(np.int32)
    store.write_values(0, values)
    store.write_marker(0, values, {"cases": 2, "successes": 1})


@pytest.mark.parametrize(
    ("make", "message"),
    [(landing, "case 1, airframe: the rotors cannot carry the weight"), (own_problem, "case 1, time")],
)
def test_the_summary_says_why_the_first_invalid_case_is_invalid(tmp_path, make, message):
    stored(make(), tmp_path / "s")
    found = mc.summarise(mc.open_sweep(tmp_path / "s", make()))
    assert found.first_invalid.startswith(message)
    assert f"1 invalid_input: {message}" in found.text()
    assert found.plain()["first_invalid"] == found.first_invalid
    assert mc.summarise(mc.open_sweep(tmp_path / "s")).first_invalid == ""  # without the study
