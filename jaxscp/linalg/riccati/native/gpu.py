"""Riccati recursion on an NVIDIA GPU: a block of threads a problem, compiled for the problem's sizes on first use."""

from pathlib import Path

import jax

from jaxscp.backends import cuda, launch, libraries
from jaxscp.linalg.riccati.in_jax import PENALTY
from jaxscp.linalg.riccati.system import Factor, KKTVector, LQProblem, no_factor

LIBRARY = libraries.RICCATI
FOLDER = Path(__file__).parent
FACTOR_THREADS, SOLVE_THREADS = 256, 128  # of a block
STATIC = 48 * 1024  # bytes of shared memory that a kernel can have without asking
NUMBER = 8  # bytes


class Sizes:
    """Sizes of a problem."""

    def __init__(self, problem: LQProblem) -> None:
        self.intervals, self.states, self.inputs = problem.flow.shape
        self.stage, self.controls = problem.last.shape[0], self.inputs - problem.last.shape[0]
        self.initial, self.final = problem.initial.shape[0], problem.final.shape[0]

    @property
    def of_factor(self) -> int:
        """Bytes of shared memory for the factorisation."""
        own = self.stage**2 + self.inputs**2 + (self.states + self.stage) * self.inputs
        return NUMBER * (own + self.controls * self.inputs)

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
        and kernels(sizes, capability, 0) is not None
    )


def kernels(sizes: Sizes, capability: str, refinements: int) -> tuple[launch.Kernel, launch.Kernel] | None:
    """Kernels of the factorisation and of a solution; None if they do not compile."""
    found = []
    for name, threads, shared in (("factor", FACTOR_THREADS, 0), ("solve", SOLVE_THREADS, sizes.of_solve)):
        macros = sizes.macros(threads) | {"JAXSCP_REFINEMENTS": refinements}
        text = (FOLDER / f"{name}.cu").read_text()
        cubin = launch.cubin(text, capability, "the Riccati recursion", (FOLDER,), **macros)
        if cubin is None:
            return None
        found.append(launch.Kernel(LIBRARY.on_gpu, cubin, threads, threads, axes=3, shared=shared))
    return found[0], found[1]


def factor(problem: LQProblem) -> Factor:
    """``in_jax.factor``, equal to rounding."""
    kernel, _ = _kernels(problem, 0)
    like = jax.eval_shape(no_factor, problem)
    shapes = [v.shape for v in (like.value, like.lower, like.gain, like.first)]
    return Factor(problem, *kernel(*jax.tree.leaves(problem), shapes=shapes))


def solve(factor: Factor, right: KKTVector, refinements: int) -> KKTVector:
    """``in_jax.solve``, equal to rounding."""
    _, kernel = _kernels(factor.problem, refinements)
    shapes = [v.shape for v in jax.tree.leaves(right)]
    return KKTVector(*kernel(*jax.tree.leaves((factor, right)), shapes=shapes))


def _kernels(problem: LQProblem, refinements: int) -> tuple[launch.Kernel, launch.Kernel]:
    capability = cuda.capability()
    found = None if capability is None else kernels(Sizes(problem), capability, refinements)
    if found is None:
        raise RuntimeError("jaxscp: no GPU here that the Riccati recursion's kernels run on")
    return found
