"""The interior point's loop in C++, for float64 on a CPU or an NVIDIA GPU: the steps of ``loop``, to rounding.

XLA runs a Newton step as hundreds of operations on arrays of a few kilobytes; most of the time passes between them.
Here a step is a few hundred thousand vector instructions on data that stay in the cache. The files, in the order in
which they include each other:

    team.h                     the threads of a CPU that solve one program together
    parallel.h                 parallel loops, for a CPU (parallel_cpu.h) or a GPU (parallel_gpu.h)
    layout.h indices.h arena.h sizes, positions in vectors, memory; several stages in one register (``pack.h``)
    matrix.h program.h         sparse matrices of all nodes, and the program
    cone_registers.h cones.h scaling.h      second-order cones and their scaling; a GPU holds cones in registers
    equilibrate.h              scales of the program
    elimination.h              elimination in one matrix, on a CPU
    shared_memory.h elimination_by_warp.h   the same by a warp of a GPU
    chain_from_ends.h, chain_by_warps.h     the links eliminated, on a CPU and on a GPU
    nearly_diagonal.h                       inverse of a nearly diagonal Hessian, on a GPU
    nodes_by_panels.h, nodes_by_warps.h     the nodes eliminated, on a CPU and on a GPU; ``nodes.h`` chooses
    squares.h, squares_by_rows.h, squares_by_warp.h   what cones add to a node's Hessian, on a CPU and on a GPU
    newton_system.h            the KKT system, as in ``kkt``
    iterate.h residuals.h starting_point.h directions.h interior_point.h    the method, as in the Python files
    batch.h buffers.h          a batch, as XLA passes it
    handler.cc                 XLA's handler on a CPU: one thread per batch element, or several for a single one
    kernel.cu gpu_handler.cc   the kernel, and XLA's handler that launches it; ``gpu.py`` compiles the kernel

The libraries are compiled when the package is installed, if there is a C++ compiler. Without them, on other devices
and in float32, the interior point runs as JAX.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np

from jaxscp.backends import libraries
from jaxscp.conic import conic_form
from jaxscp.conic.native import gpu
from jaxscp.conic.program import StagedProgram, WarmStart
from jaxscp.core.types import Scalar

LIBRARY = libraries.INTERIOR_POINT
(TARGET,) = LIBRARY.targets
MAX_GROUPS, MAX_CONES, MAX_LINES = 32, 256, 1 << 15  # at a node, as in ``layout.h``


def supports(program: StagedProgram) -> bool:
    """Whether the compiled loop can solve this program on a CPU."""
    return _sizes_fit(program) and LIBRARY.available()


def supports_on_gpu(program: StagedProgram) -> bool:
    """Whether the kernel can solve this program on the GPU that is JAX's default device."""
    return _sizes_fit(program) and gpu.available() and gpu.supports(program)


def _sizes_fit(program: StagedProgram) -> bool:
    """Whether all numbers are float64 and all sizes are within the limits of ``layout.h``."""
    cones = [c.offset.shape[1] for c in program.cones]
    few = len(cones) <= MAX_GROUPS and sum(cones) + 2 <= MAX_CONES
    links, rows = program.links.soft.shape[1], program.rows.offset.shape[1]
    lines = max(program.variables, links, rows, sum(math.prod(c.offset.shape[1:]) for c in program.cones))
    return libraries.in_float64(program) and few and lines <= MAX_LINES and links > 0


def call(
    program: StagedProgram, tolerance: Scalar, warm_start: WarmStart | None = None, **settings: float | int
):
    """Result of the loop on a CPU, which equilibrates the program first.

    Args:
        program: in float64.
        tolerance: relative gap and residuals below which the program is solved.
        warm_start: estimate of the solution.
        settings: settings of the ``InteriorPoint``, under the same names.

    Returns:
        Arrays of the last iterate (x, y, s, tau, kappa) in equilibrated units, without the zero cone's slack, which is
        zero; then error, infeasibility, unboundedness, iterations, stalled, broken; then the fields of ``Scales``.
    """
    return _call(TARGET, program, tolerance, warm_start, settings)


def call_on_gpu(
    program: StagedProgram, tolerance: Scalar, warm_start: WarmStart | None = None, **settings: float | int
):
    """Result of the loop on the GPU that is JAX's default device; see ``call``."""
    return _call(gpu.TARGET, program, tolerance, warm_start, settings | gpu.attributes(program))


def _call(
    target: str, program: StagedProgram, tolerance: Scalar, warm_start: WarmStart | None, attributes: dict
):
    norm = program.norm
    arrays = [program.hessian, program.gradient, *_link_arrays(program)]
    arrays += [program.rows.matrix, program.rows.offset, tolerance]
    for cone in program.cones:
        arrays += [cone.matrix, cone.offset]
    if norm is not None:
        arrays += [norm.weight, norm.scale, norm.centre]
    if warm_start is not None:
        y = warm_start.multipliers
        arrays += [warm_start.z, y.links, y.rows, *y.cones]
    has = {"has_norm": np.int64(norm is not None), "has_warm_start": np.int64(warm_start is not None)}
    solve = jax.ffi.ffi_call(target, _results(program), vmap_method="broadcast_all")
    return solve(*arrays, **has, **attributes)


def _link_arrays(program: StagedProgram) -> list:
    links = program.links
    return [links.before, links.after, links.offset, links.soft, links.weight]


def _results(program: StagedProgram) -> list[jax.ShapeDtypeStruct]:
    """Shapes of the results, in the order of ``call``."""
    q, b = conic_form.linear_cost(program), conic_form.constraint_offset(program)
    like = lambda v: jax.ShapeDtypeStruct(v.shape, v.dtype)  # noqa: E731
    scalar, flag = jax.ShapeDtypeStruct((), jnp.float64), jax.ShapeDtypeStruct((), jnp.bool_)
    count = jax.ShapeDtypeStruct((), jnp.int64)
    vectors = [*map(like, (q.z, q.xi, q.zeta, b.zero, b.orthant, b.second, b.orthant, b.second))]
    scales = [*map(like, (program.gradient, program.links.offset, program.rows.offset))]
    scales += [jax.ShapeDtypeStruct(c.offset.shape[:2], jnp.float64) for c in program.cones]
    return [*vectors, *[scalar] * 5, count, flag, flag, *scales, scalar]
