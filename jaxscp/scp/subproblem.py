"""One subproblem of ``NewtonSCP``, solved: the step, its multipliers, and the decrease that the model predicts."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.conic.program import ConicSolution, StagedProgram, WarmStart
from jaxscp.core.types import Flag, Scalar
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.scp.convex_model import ConvexModel
from jaxscp.scp.interval_subproblem import has_buffer, interval_program, nlp_multipliers, node_step
from jaxscp.scp.state import NewtonSettings, NewtonState
from jaxscp.transcription.lagrangian import Merit, Residual
from jaxscp.transcription.layout import cost_gradient, interval_variables
from jaxscp.transcription.shooting import Linearisation

FORCING_FACTOR = 0.1  # of the accuracy, from a subproblem to the next
ROUNDING = 1e-7  # relative error of the cost at the subproblem's tolerance


class SubproblemSolution(eqx.Module):
    """Step from the reference, and its prediction."""

    step: Float[Array, "nodes variables"]
    step_norm: Scalar
    """Largest change of a node, in typical sizes."""
    multipliers: Multipliers
    virtual_control: Float[Array, "intervals states"]
    merit: Merit
    """Merit function with these multipliers."""
    decrease: Scalar
    """Predicted decrease of the merit, with the Lagrangian's own Hessian: of either sign, as that is not convex."""
    decrease_negligible: Flag
    """Whether the decrease is below the rounding of the cost."""
    forcing: Scalar
    """Relative accuracy that the subproblem was solved to."""
    conic: ConicSolution


def solve_subproblem(
    settings: NewtonSettings,
    problem: ScaledTimeProblem,
    state: NewtonState,
    model: ConvexModel,
    done: Flag,
) -> SubproblemSolution:
    """Solve the convex subproblem about the reference; a batch element that is done takes no step."""
    program = interval_program(
        problem, state.z, state.linear, model.hessian, model.gradient, settings.virtual_weight
    )
    warm_start = WarmStart(jnp.zeros_like(program.gradient), state.conic_multipliers, state.iterations > 0)
    forcing = jnp.where(done, jnp.inf, forcing_term(settings, state))
    solution = settings.conic(program, forcing, warm_start)

    multipliers = nlp_multipliers(problem, state.linear, solution.multipliers)
    step = node_step(problem, solution.z)
    virtual_control = program.virtual_control(solution.z)[1:-1, : problem.state_size]
    predicted = _predicted_residual(problem, state, solution.z, step, virtual_control)
    merit = Merit(problem, multipliers, settings.merit_weight, state.scale[: problem.state_size])
    now = state.residual
    decrease = merit(now) - merit(predicted)
    return SubproblemSolution(
        step=step,
        step_norm=jnp.max(jnp.linalg.norm(step / state.scale, axis=1)),
        multipliers=multipliers,
        virtual_control=virtual_control,
        merit=merit,
        decrease=decrease,
        decrease_negligible=jnp.abs(decrease) <= ROUNDING * (1.0 + jnp.abs(now.cost)),
        forcing=forcing,
        conic=solution,
    )


def forcing_term(settings: NewtonSettings, state: NewtonState) -> Scalar:
    """Relative accuracy of the next subproblem: early models change soon, and need little."""
    return settings.initial_forcing * FORCING_FACTOR ** state.iterations.astype(state.cost.dtype)


def _predicted_residual(
    problem: ScaledTimeProblem, state: NewtonState, stages, step, virtual_control
) -> Residual:
    """Residual after the step, by the model: feasible but for virtual control and virtual buffer."""
    gradient = cost_gradient(problem, state.z, state.linear.jacobian.cost)
    slope = jnp.vdot(gradient, stages[:, : gradient.shape[1]])
    w = interval_variables(problem, step)
    now = state.residual
    cost = now.cost + slope + 0.5 * jnp.einsum("iw,iwv,iv->", w, state.hessian, w)
    if problem.curved_end:
        end = step[-1, : problem.state_size]
        cost += 0.5 * end @ problem.terminal_hessian(state.z) @ end
    buffer = -stages[:-1, -1:, None] if has_buffer(problem) else jnp.zeros(())
    values = tuple(
        jnp.broadcast_to(jnp.zeros(()) if c.convex else buffer, v.shape)
        for c, v in zip(problem.constraints, now.values, strict=True)
    )
    ends = jnp.zeros_like(now.initial), jnp.zeros_like(now.final)
    return Residual(cost, virtual_control, values, *ends)


def program_like(
    problem: ScaledTimeProblem, z: Float[Array, "nodes variables"], linear: Linearisation
) -> StagedProgram:
    """Shapes of a subproblem."""
    inputs = linear.jacobian.end.shape[-1]
    like = lambda *shape: jax.ShapeDtypeStruct((problem.nodes, *shape), z.dtype)  # noqa: E731
    return jax.eval_shape(
        lambda hessian, gradient: interval_program(problem, z, linear, hessian, gradient, 1.0),
        like(inputs, inputs),
        like(inputs),
    )
