"""Riccati recursion for float64: in C++ on a CPU if compiled, in kernels on an NVIDIA GPU; else in JAX.

XLA runs a step of the recursion as dozens of operations on matrices of a few kilobytes, and spends most of its time
between them.
"""

import functools

import jax
import jax.numpy as jnp

from jaxscp.backends.libraries import dispatch, in_float64
from jaxscp.core.types import Scalar
from jaxscp.linalg.riccati import in_jax, native
from jaxscp.linalg.riccati.native import gpu
from jaxscp.linalg.riccati.system import Factor, KKTVector, LQProblem, Shifts, no_factor

REFINEMENTS = 3


def factor(problem: LQProblem) -> Factor:
    """Factor of the system's matrix, by the backward recursion."""
    cpu = native.factor if _compiled(problem) else None
    return dispatch(cpu, in_jax.factor, problem, cuda=gpu.factor if gpu.supports(problem) else None)


def factor_shifted(problem: LQProblem, least: Scalar, shifts: Shifts) -> tuple[Factor, Scalar]:
    """Factor of the first matrix that is definite, and its shift: zero, then ``least``, then larger ones.

    Where none is, the factor of the last one.
    """
    by_trials = functools.partial(_by_trials, shifts=shifts)
    cuda = functools.partial(gpu.factor_shifted, shifts=shifts) if gpu.supports(problem) else None
    return dispatch(None, by_trials, problem, least, cuda=cuda)


def _by_trials(problem: LQProblem, least: Scalar, shifts: Shifts) -> tuple[Factor, Scalar]:
    def fails(carry):
        factor, shift, _ = carry
        return ~factor.definite & (shift < shifts.most)

    def retry(carry):
        _, _, shift = carry
        larger = jax.lax.select(shift > 0, shifts.growth * shift, least)
        return factor(problem.shifted(shift)), shift, larger

    none = jnp.zeros_like(least)
    found, shift, _ = jax.lax.while_loop(fails, retry, (no_factor(problem), none, none))
    return found, shift


def solve(factor: Factor, right: KKTVector, refinements: int = REFINEMENTS) -> KKTVector:
    """Solution for one right-hand side.

    Args:
        factor: factor of the system's matrix.
        right: right-hand side.
        refinements: steps of iterative refinement; without any, end conditions hold to the penalty's accuracy.
    """
    refined = functools.partial(native.solve, refinements=refinements)
    cpu = refined if _compiled(factor.problem) else None
    cuda = functools.partial(gpu.solve, refinements=refinements) if gpu.supports(factor.problem) else None
    return dispatch(cpu, functools.partial(in_jax.solve, refinements=refinements), factor, right, cuda=cuda)


def _compiled(problem: LQProblem) -> bool:
    return in_float64(problem) and native.LIBRARY.available()
