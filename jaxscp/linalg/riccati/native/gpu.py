"""Riccati recursion on an NVIDIA GPU: a block of threads a problem, compiled for the problem's sizes on first use."""

from pathlib import Path

import jax
import jax.numpy as jnp

from jaxscp.backends import cuda, launch, libraries
from jaxscp.core.types import Scalar
from jaxscp.linalg.riccati.in_jax import PENALTY
from jaxscp.linalg.riccati.system import Factor, KKTVector, LQProblem, Shifts, no_factor

LIBRARY = libraries.RICCATI
FOLDER = Path(__file__).parent
FACTOR_THREADS, SOLVE_THREADS = 160, 128  # of a block; a tile of the factorisation for each thread
STATIC = 48 * 1024  # bytes of shared memory that a kernel can have without asking
NUMBER = 8  # bytes
NO_SHIFTS = Shifts(growth=1.0, most=0.0)
UNAVAILABLE = "jaxscp: no GPU here that the Riccati recursion's kernels run on"


class Sizes:
    """Sizes of a problem."""

    def __init__(self, problem: LQProblem) -> None:
        self.intervals, self.states, self.inputs = problem.flow.shape
        self.stage, self.controls = problem.last.shape[0], self.inputs - problem.last.shape[0]
        self.initial, self.final = problem.initial.shape[0], problem.final.shape[0]

    @property
    def of_factor(self) -> int:
        """Bytes of shared memory for the factorisation."""
        stage, inputs = self.stage + self.stage % 2, self.inputs + self.inputs % 2
        own = stage**2 + inputs**2 + (self.states + stage) * inputs
        return NUMBER * (own + self.controls * stage + 1)

    @property
    def of_solve(self) -> int:
        """Bytes of shared memory for a solution."""
        nodes, flow = (self.intervals + 1) * self.stage, self.intervals * self.states
        vector = nodes + flow + max(1, self.initial) + max(1, self.final)
        return NUMBER * (4 * vector + nodes + self.intervals * self.controls + self.inputs + self.stage)

    def macros(self, threads: int) -> dict[str, object]:
        """Preprocessor definitions of the kernels."""
        names = "intervals", "states", "inputs", "stage", "initial", "final"
        sizes = {f"JAXSCP_{name.upper()}": getattr(self, name) for name in names}
        return sizes | {"JAXSCP_THREADS": threads, "JAXSCP_PENALTY": repr(PENALTY)}


def supports(problem: LQProblem) -> bool:
    """Whether kernels can serve problems of these sizes on the GPU that is JAX's default device."""
    if not (libraries.in_float64(problem) and launch.available(LIBRARY)):
        return False
    sizes, capability = Sizes(problem), cuda.capability()
    return (
        capability is not None
        and sizes.inputs <= SOLVE_THREADS
        and sizes.of_factor <= STATIC
        and sizes.of_solve <= cuda.shared_memory(capability)
        and factor_kernel(sizes, capability, NO_SHIFTS) is not None
        and solve_kernel(sizes, capability, 0) is not None
    )


def factor_kernel(sizes: Sizes, capability: str, shifts: Shifts) -> launch.Kernel | None:
    """Kernel of the factorisation; None if it does not compile."""
    macros: dict[str, object] = {"JAXSCP_GROWTH": repr(shifts.growth), "JAXSCP_MOST": repr(shifts.most)}
    return _kernel("factor", FACTOR_THREADS, 0, sizes, capability, macros)


def solve_kernel(sizes: Sizes, capability: str, refinements: int) -> launch.Kernel | None:
    """Kernel of a solution; None if it does not compile."""
    macros: dict[str, object] = {"JAXSCP_REFINEMENTS": refinements}
    return _kernel("solve", SOLVE_THREADS, sizes.of_solve, sizes, capability, macros)


def _kernel(
    name: str, threads: int, shared: int, sizes: Sizes, capability: str, macros: dict[str, object]
) -> launch.Kernel | None:
    text, all_macros = (FOLDER / f"{name}.cu").read_text(), sizes.macros(threads) | macros
    cubin = launch.cubin(text, capability, "the Riccati recursion", (FOLDER, libraries.HEADERS), **all_macros)
    if cubin is None:
        return None
    return launch.Kernel(LIBRARY.on_gpu, cubin, threads, threads, axes=3, shared=shared)


def factor(problem: LQProblem) -> Factor:
    """``in_jax.factor``, equal to rounding."""
    return factor_shifted(problem, jnp.zeros((), problem.flow.dtype), NO_SHIFTS)[0]


def factor_shifted(problem: LQProblem, least: Scalar, shifts: Shifts) -> tuple[Factor, Scalar]:
    """``recursion.factor_shifted``; a problem that is definite does not wait for others of its batch."""
    kernel = factor_kernel(Sizes(problem), _capability(), shifts)
    if kernel is None:
        raise RuntimeError(UNAVAILABLE)
    like = jax.eval_shape(no_factor, problem)
    shapes = [v.shape for v in (like.value, like.lower, like.gain, like.first, least)]
    *found, shift = kernel(*jax.tree.leaves(problem), least, shapes=shapes)
    return Factor(problem.shifted(shift), *found), shift


def solve(factor: Factor, right: KKTVector, refinements: int) -> KKTVector:
    """``in_jax.solve``, equal to rounding."""
    kernel = solve_kernel(Sizes(factor.problem), _capability(), refinements)
    if kernel is None:
        raise RuntimeError(UNAVAILABLE)
    shapes = [v.shape for v in jax.tree.leaves(right)]
    return KKTVector(*kernel(*jax.tree.leaves((factor, right)), shapes=shapes))


def _capability() -> str:
    capability = cuda.capability()
    if capability is None:
        raise RuntimeError(UNAVAILABLE)
    return capability
