"""The result of a method, as a function of the problem."""

from typing import Any

import equinox as eqx
import jax
from jaxtyping import Array, Float

from jaxscp.core.status import StatusCode
from jaxscp.core.types import Count, Flag, Scalar
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.scp.history import History


class MethodResult(eqx.Module):
    """What a method found, as a function of the problem."""

    z: Float[Array, "nodes variables"]
    cost: Scalar
    multipliers: Multipliers | None
    reached: Flag
    """Whether it is an optimum to rounding."""
    newton_steps: Count
    """Of the interior point that ended there."""


class End(eqx.Module):
    """What is judged of a method's last state."""

    z: Float[Array, "nodes variables"]
    multipliers: Multipliers | None
    cost: Scalar
    iterations: Count
    status: StatusCode
    history: History


def solve(
    method: Any,
    problem: OptimalControlProblem,
    z: Float[Array, "nodes variables"],
    wanted: Flag | bool = True,
) -> tuple[End, MethodResult]:
    """The method's end, and its answer as a function of the problem: gradients go round the iterations."""
    frozen, z = jax.lax.stop_gradient((problem, z))
    state = method.run(frozen, z, wanted)
    multipliers = getattr(state, "multipliers", None)
    end = End(state.z, multipliers, state.cost, state.iterations, state.status, state.history)
    return end, method.answer(problem, state)
