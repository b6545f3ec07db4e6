"""Conversion of a landing problem: rivals' arrays to jaxscp's problem, and scenario to rivals' arrays.

Both directions keep every number, so that the two stacks can be compared digit by digit.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.integrate import simpson

from benchmarks.rivals.problem import Flags, Floats, LandingArrays, extended_controls
from jaxscp.cones.cone import NonNegative, SecondOrder
from jaxscp.dynamics.rigid_body import RigidBody
from jaxscp.landing.allocation import allocate
from jaxscp.landing.constraints import (
    HalfSpaces,
    LandingCone,
    Limits,
    inside_half_spaces,
    inside_landing_cone,
    within_control_limits,
)
from jaxscp.landing.guess import initial_guess
from jaxscp.landing.mission import Weights
from jaxscp.landing.problem import (
    FixedComponents,
    effort,
    fixed_components,
    flight_time,
    landing_problem,
    pose_rows,
)
from jaxscp.landing.scenario import LandingScenario
from jaxscp.problem.boundary import Boundary, EndCondition
from jaxscp.problem.constraint import Constraint, repeat_over_nodes
from jaxscp.problem.cost import Cost
from jaxscp.problem.form import Paper
from jaxscp.problem.lowering import over_scaled_time
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.problem.time import FreeTime, Time
from jaxscp.scp.nodal_subproblem import PAPER_NODES, NormTrustRegion
from jaxscp.scp.ptr import PTR


def as_problem(arrays: LandingArrays) -> tuple[ScaledTimeProblem, Float[Array, "nodes variables"]]:
    """The rivals' problem over scaled time, and its guess as node variables.

    Elapsed effort and time are states, as in the published stack, since its trust region counts them.
    """
    weights = Weights(jnp.asarray(arrays.weight_control, float), jnp.asarray(arrays.weight_time, float))
    problem = OptimalControlProblem(
        dynamics=RigidBody(
            mass=jnp.asarray(arrays.mass, float),
            inertia=jnp.asarray(arrays.inertia),
            thrust_map=jnp.asarray(arrays.thrust_map),
            torque_map=jnp.asarray(arrays.torque_map),
            gravity=jnp.array([0.0, 0.0, -arrays.gravity]),
        ),
        cost=Cost(effort, flight_time, weights),
        boundary=Boundary(_whole_state(arrays.start), _whole_state(arrays.goal)),
        time=Time(arrays.nodes, FreeTime(arrays.dilation_min, arrays.dilation_max), mesh_weight=None),
        constraints=_constraints(arrays),
    )
    return over_scaled_time(problem, Paper()), jnp.asarray(_node_variables(arrays))


def as_method(arrays: LandingArrays) -> PTR:
    """Algorithm 1 with the settings that the arrays hold."""
    return PTR(
        trust_region=NormTrustRegion(arrays.weight_trust * arrays.nodes / PAPER_NODES),
        virtual_weight=arrays.weight_virtual,
        tolerance_virtual=arrays.tolerance_virtual,
        tolerance_step=arrays.tolerance_trust,
        max_iterations=arrays.max_iterations,
        substeps=arrays.substeps,
    )


def as_arrays(scenario: LandingScenario, nodes: int, method: PTR | None = None) -> LandingArrays:
    """A scenario and its initial guess as the rivals' arrays; by default with the paper's settings."""
    method = PTR() if method is None else method
    assert isinstance(method.trust_region, NormTrustRegion), "the published stack knows no other trust region"
    problem, guess = _problem_and_guess(scenario, nodes)
    body, frame = scenario.airframe.body, scenario.airframe
    by_name = {constraint.name: constraint for constraint in problem.constraints}
    corridor, cone = by_name["corridor"], by_name["landing cone"]
    return LandingArrays(
        mass=float(body.mass),
        inertia=np.asarray(body.inertia),
        thrust_map=np.asarray(body.thrust_map),
        torque_map=np.asarray(body.torque_map),
        gravity=-float(body.gravity[2]),
        normals=np.asarray(corridor.parameters.normals),
        offsets=np.asarray(corridor.parameters.offsets),
        cone_active=np.asarray(cone.active),
        cone_apex=np.asarray(cone.parameters.apex[-1]),
        cone_cotangent=float(cone.parameters.cotangent[-1]),
        thrust_min=np.asarray(frame.thrust_min),
        thrust_max=np.asarray(frame.thrust_max),
        dilation_min=float(scenario.dilation_min),
        dilation_max=float(scenario.dilation_max),
        start=np.asarray(problem.boundary.initial.parameters.value),
        goal=np.asarray(problem.boundary.final.parameters.value),
        weight_control=float(scenario.weights.control),
        weight_time=float(scenario.weights.time),
        weight_virtual=method.virtual_weight,
        weight_trust=method.trust_region.at_node(nodes),
        tolerance_virtual=method.tolerance_virtual,
        tolerance_trust=method.tolerance_step,
        max_iterations=method.max_iterations,
        substeps=method.substeps,
        states=np.asarray(guess.states),
        controls=np.asarray(guess.controls),
        dilation=np.asarray(guess.dilation),
    )


def _problem_and_guess(scenario: LandingScenario, nodes: int):
    allocation = allocate(scenario.route(), nodes)
    guess = jax.jit(initial_guess)(scenario, allocation)
    return landing_problem(scenario, allocation, Paper()), guess


def _constraints(arrays: LandingArrays) -> tuple[Constraint, ...]:
    nodes = arrays.nodes
    everywhere = jnp.ones(nodes, bool)
    faces = HalfSpaces(jnp.asarray(arrays.normals), jnp.asarray(arrays.offsets))
    limits = Limits(jnp.asarray(arrays.thrust_min), jnp.asarray(arrays.thrust_max))
    cone = LandingCone(
        jnp.asarray(arrays.cone_apex), jnp.zeros(3), jnp.eye(3), jnp.asarray(arrays.cone_cotangent, float)
    )
    held = functools.partial(Constraint, per_node=True, convex=True)
    return (
        held(inside_half_spaces, NonNegative(), faces, active=everywhere, name="corridor"),
        held(
            within_control_limits,
            NonNegative(),
            repeat_over_nodes(limits, nodes),
            active=everywhere,
            name="thrust",
        ),
        held(
            inside_landing_cone,
            SecondOrder(),
            repeat_over_nodes(cone, nodes),
            active=jnp.asarray(_meaningful_cones(arrays)),
            name="landing cone",
        ),
    )


def _meaningful_cones(arrays: LandingArrays) -> Flags:
    """Cone flags (N,) of the arrays; False at the last node if the goal fixes this node at the apex.

    There the boundary condition implies the cone, so the optimum is the same. With both constraints the feasible
    set has no interior, and a multiplier may grow without bound.
    """
    active = arrays.cone_active.copy()
    active[-1] &= not np.array_equal(arrays.goal[:3], arrays.cone_apex)
    return active


def _whole_state(value: Floats) -> EndCondition:
    everything = FixedComponents(jnp.asarray(value), jnp.ones(len(value)))
    return EndCondition(fixed_components, everything, pose_rows(4))


def _node_variables(arrays: LandingArrays) -> Floats:
    """Rows (x, phi, t, u, s); phi by the steps of the discretisation, which integrate by Simpson's rule."""
    extended = extended_controls(arrays)
    fraction = np.linspace(0.0, 1.0, 2 * arrays.substeps + 1)[:, None]
    controls = (1.0 - fraction) * extended[:-1, None] + fraction * extended[1:, None]
    rate = arrays.weight_control * np.linalg.norm(controls[..., :-1], axis=-1) * controls[..., -1]
    rates = np.stack([rate, controls[..., -1]], axis=-1)
    integrals = simpson(rates, dx=arrays.interval / (len(fraction) - 1), axis=1)
    elapsed = np.concatenate([np.zeros((1, 2)), np.cumsum(integrals, axis=0)])
    return np.column_stack([arrays.states, elapsed, extended])
