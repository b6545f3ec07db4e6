"""A method of solution: iterations on node variables, and their result as a function of the problem."""

from typing import Any, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxscp.backends.serving import Backends
from jaxscp.core import batching
from jaxscp.core.status import StatusCode
from jaxscp.core.types import Count, Flag, Scalar
from jaxscp.problem.form import Form
from jaxscp.problem.multipliers import Multipliers
from jaxscp.problem.scaled_time import ScaledTimeProblem
from jaxscp.scp import mesh
from jaxscp.scp.history import History
from jaxscp.scp.restart import restarted
from jaxscp.transcription.shooting import Grid


class MethodResult(eqx.Module):
    """Result of a method; ``z``, ``cost`` and ``multipliers`` have derivatives with respect to the problem."""

    z: Float[Array, "nodes variables"]
    cost: Scalar
    multipliers: Multipliers | None
    """None if the method has none."""
    is_optimum: Flag
    """Whether ``z`` is a local optimum to rounding."""
    interior_point_iterations: Count
    """Newton steps of the interior point that led to the optimum."""
    iterations: Count
    """Subproblems solved."""
    status: StatusCode
    history: History
    backends: Backends
    """Implementations that ran."""


@runtime_checkable
class Method(Protocol):
    """Interface of a method: ``init``, ``step`` and ``terminate`` are pure; ``run`` is the loop over them."""

    @property
    def form(self) -> Form:
        """Statement of the problem that the method solves."""
        ...

    @property
    def holds_between_nodes(self) -> bool:
        """Whether a converged solution claims to satisfy its constraints between the nodes too."""
        ...

    @property
    def grid(self) -> Grid | None:
        """Points of an interval at which its constraints hold; None if they hold at the nodes only."""
        ...

    def init(self, problem: ScaledTimeProblem, z: Float[Array, "nodes variables"]) -> Any:
        """State before the first iteration, from a guess."""
        ...

    def terminate(self, state: Any) -> Flag:
        """Whether the loop is over."""
        ...

    def on_the_way(self, state: Any) -> Flag | bool:
        """Whether the limit of the iterations ended a way that may lead to a solution."""
        ...

    def run(
        self,
        problem: ScaledTimeProblem,
        z: Float[Array, "nodes variables"],
        enabled: Flag | bool = True,
        keep_mesh: Flag | bool = False,
    ) -> Any:
        """Last state from a guess.

        Args:
            problem: to solve.
            z: the guess.
            enabled: a batch element that is not enabled takes no step.
            keep_mesh: whether the guess has a good mesh, from an earlier plan, near which the method may stay.
        """
        ...

    def result(self, problem: ScaledTimeProblem, state: Any) -> MethodResult:
        """Result of the last state, as a function of the problem."""
        ...


def iterate(
    method: Method,
    problem: ScaledTimeProblem,
    z: Float[Array, "nodes variables"],
    enabled: Flag | bool = True,
    keep_mesh: Flag | bool = False,
) -> MethodResult:
    """Result of a method from the guess z; derivatives bypass the iterations."""
    frozen = jax.lax.stop_gradient((problem, z, jnp.asarray(enabled), jnp.asarray(keep_mesh)))
    state, most = batching.alone_on_a_cpu(lambda fixed: restarted(method, *fixed), frozen)
    return method.result(mesh.bounded(problem, most), state)
