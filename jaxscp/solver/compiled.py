"""Solvers compiled ahead of their first call: for problems with the same functions and shapes."""

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp

from jaxscp.aot.aot import CompiledPlanner, one_element
from jaxscp.aot.pytree_spec import Spec, difference, spec_of
from jaxscp.backends.xla import is_traced
from jaxscp.problem.canonical import canonical
from jaxscp.problem.problem import OptimalControlProblem
from jaxscp.problem.trajectory import Trajectory
from jaxscp.solver.request import Request
from jaxscp.solver.solution import Solution


def signature(problem: OptimalControlProblem, asked: Request) -> Spec:
    """Names and shapes of a problem's numbers and of its request's guess, and a hash of the problem's functions."""
    numbers = {name: _like(value) for name, value in problem.arrays().items()}
    known = spec_of({"problem": numbers, "guess": jax.tree.map(_like, asked.start)})
    return known | {"functions": _functions(asked.asked)}


def _functions(asked: OptimalControlProblem) -> str:
    """Hash of the functions and parts of a canonical problem."""
    text = json.dumps(spec_of(asked), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _like(value: Any) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(jnp.shape(value), jnp.result_type(value))


@dataclasses.dataclass(frozen=True)
class CompiledSolver:
    """A solver for problems of one shape, compiled before its first call; a call traces nothing.

    ``Solver.compile`` and ``jaxscp.load`` make these. Solutions equal the solver's bitwise.
    """

    compiled: CompiledPlanner = dataclasses.field(repr=False)
    signature: Spec = dataclasses.field(repr=False)

    @property
    def nodes(self) -> int:
        """N."""
        return self.compiled.nodes

    @property
    def batch_size(self) -> int | None:
        """Problems a call; None for one without a leading axis."""
        return self.compiled.batch_size

    def __call__(
        self, problem: OptimalControlProblem | Mapping[str, Any], guess: Trajectory | Solution
    ) -> Solution:
        """The solution of a problem, or of ``batch_size`` of them, stacked.

        Args:
            problem: a problem with the same functions, or ``problem.arrays()``: all its numbers by name.
            guess: a trajectory on the solver's nodes, or a solution.

        Raises:
            TypeError: if names, shapes or dtypes are not those that the solver was compiled for.
        """
        if isinstance(problem, OptimalControlProblem):
            self._check_functions(problem)
        numbers = problem.arrays() if isinstance(problem, OptimalControlProblem) else dict(problem)
        path = guess.trajectory if isinstance(guess, Solution) else guess
        if is_traced((numbers, path)):
            raise TypeError(
                "a compiled solver takes arrays; inside jit, vmap and grad, call the Solver itself"
            )
        expected = self.signature["entries"]["problem"]["entries"]
        if missing := sorted(set(expected) - set(numbers)):
            raise TypeError(
                f"problem: {missing[0]!r} is missing; the solver was compiled for a problem with it"
            )
        if unknown := sorted(set(numbers) - set(expected)):
            raise TypeError(f"problem: {unknown[0]!r} is unknown to the solver")
        ordered = {name: jnp.asarray(numbers[name], part["dtype"]) for name, part in expected.items()}
        nodes = (jnp.asarray(v, float) for v in (path.time, path.state, path.control, path.dilation))
        path = Trajectory(*nodes)  # pyright: ignore[reportArgumentType]: four, which it cannot count
        one = (ordered, path) if self.batch_size is None else one_element((ordered, path), self.batch_size)
        expected_shapes = {"entries": self.signature["entries"]}
        differs = difference(expected_shapes, spec_of({"problem": one[0], "guess": one[1]}))
        if differs:
            raise TypeError(f"the solver was compiled for problems of another shape: {differs}")
        return self.compiled.run([*ordered.values(), *jax.tree.leaves(path)])

    def _check_functions(self, problem: OptimalControlProblem) -> None:
        """Raise for a problem of other functions; of a batch, shapes differ by its axis and are checked alone."""
        if self.batch_size is None and _functions(canonical(problem)) != self.signature["functions"]:
            raise TypeError("problem: its functions or parts are not those that the solver was compiled for")
