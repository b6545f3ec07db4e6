"""Limits that hold during most of a flight: each plan is an optimum, and has the right derivatives."""

import dataclasses
import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxscp
from jaxscp.nlp.central_path import MU
from jaxscp.nlp.interior_point import NLPInteriorPoint
from jaxscp.transcription.shooting import evaluate, total_cost
from tests.support.flights import problem_over_scaled_time

PLANNER = jaxscp.Planner()
GRID = jaxscp.NewtonSCP().grid
AGAIN = NLPInteriorPoint(initial_mu=MU)
BASE = jaxscp.scenarios.platform_to_platform()
ROUNDING = 1e-6  # relative, of a cost: the accuracy of an optimum
DIFFERENCE = 1e-4  # relative: a gradient against central differences
STEP = 1e-4  # of differences, relative

SPEEDS = [{"speed": v} for v in np.linspace(1.5, 5.5, 17)]
TILTS = [{"tilt": v} for v in np.linspace(0.2, 0.8, 7)]
BODY_RATES = [{"body_rate": v} for v in np.linspace(0.5, 3.5, 7)]
THRUST_RATES = [{"thrust_rate": v} for v in np.linspace(3.0, 30.0, 7)]
ALL = [
    {
        "speed": 2.5 + 2.0 * k,
        "tilt": 0.35 + 0.3 * k,
        "body_rate": 1.5 + 2.0 * k,
        "thrust_rate": 8.0 + 12.0 * k,
    }
    for k in np.linspace(0.0, 1.0, 20)
]


def limited(limits):
    return dataclasses.replace(BASE, limits=jaxscp.flight_limits(**limits))


def names(limits):
    return " ".join(f"{name} {value:.3g}" for name, value in limits.items())


def nightly(cases):
    return [pytest.param(case, marks=pytest.mark.nightly) for case in cases]


@pytest.mark.parametrize(
    "limits",
    [
        *nightly(SPEEDS),
        *nightly(TILTS),
        *nightly(BODY_RATES),
        *nightly(THRUST_RATES),
        *nightly(ALL),
    ],
    ids=names,
)
def test_the_plan_is_an_optimum(limits):
    solution = PLANNER(limited(limits))
    assert jaxscp.status_names(solution.status) == "converged"
    assert bool(solution.differentiable)
    assert bool(solution.certificate.passed())


@pytest.mark.nightly
def test_a_looser_limit_costs_no_more():
    """Where two plans take the same way; the optimum falls as the limit rises."""
    costs = [float(PLANNER(limited(limits)).cost) for limits in SPEEDS]
    assert all(after <= before * (1.0 + ROUNDING) for before, after in itertools.pairwise(costs))


@pytest.mark.nightly
@pytest.mark.parametrize("limits", [SPEEDS[4], SPEEDS[6], TILTS[2], ALL[5]], ids=names)
def test_gradients_are_differences(limits):
    """Of optima found by the interior point alone, from the first one: a plan may end at another local optimum."""
    base = limited(limits)
    name = next(iter(limits))
    solution = PLANNER(base)

    def with_limit(value):
        return eqx.tree_at(lambda s: getattr(s.limits, name), base, jnp.asarray(value, float))

    @jax.jit
    def optimum(value):
        problem = problem_over_scaled_time(with_limit(value), PLANNER.nodes_for(with_limit(value)))
        found = AGAIN.run(problem, solution.z, solution.multipliers, GRID)
        return total_cost(problem, found.z, evaluate(problem, found.z, GRID)), AGAIN.is_optimum(found)

    def again(value):
        cost, is_optimum = optimum(value)
        assert bool(is_optimum)
        return float(cost)

    gradient = jax.grad(lambda v: PLANNER(with_limit(v)).cost)(limits[name])
    step = STEP * limits[name]
    difference = (again(limits[name] + step) - again(limits[name] - step)) / (2.0 * step)
    np.testing.assert_allclose(gradient, difference, rtol=DIFFERENCE)
