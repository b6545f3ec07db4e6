"""The interior point's loop in C++, for float64 on a CPU or an NVIDIA GPU: the same steps as ``interior_point``, to
rounding.

XLA runs a Newton step as hundreds of operations on arrays of a few kilobytes, and most of its time goes between them.
Here a step is a few hundred thousand vector instructions on data that stay in the cache. The files, in the order in
which they build on each other:

    team.h threads.h           who does what: phases that the threads of a team, or of a GPU's block, share
    layout.h arena.h           what lies where, several nodes of the chain in one register (``backends/native/pack.h``)
    held.h                     what a cone has of a vector, in registers while a GPU works on it
    elimination.h, elimination_by_warp.h    one matrix eliminated, on a CPU and on a GPU
    program.h cones.h scaling.h             the program, its cones and their scaling
    chain_from_ends.h, chain_by_warps.h     the chain of links factored, on a CPU and on a GPU
    nearly_diagonal.h                       a node's inverse where few of its variables are tied, on a GPU
    nodes_by_panels.h, nodes_by_warps.h     the nodes eliminated and the chain with them; ``nodes.h`` chooses
    scales.h                                its scales, and the program in their units
    newton_system.h interior_point.h        the method, the same text on both
    batch.h buffers.h          lanes of a batch, as XLA passes them
    handler.cc                 what XLA calls on a CPU: a thread a lane, or for a single lane all that are free
    kernel.cu gpu_handler.cc   the kernel, and what XLA calls to launch it; ``gpu.py`` compiles it

The libraries are compiled when the package is installed, if there is a C++ compiler. Without them, on other devices,
and in float32, the interior point runs as JAX.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np

from jaxscp.backends import libraries
from jaxscp.conic import kkt
from jaxscp.conic.native import gpu
from jaxscp.conic.program import StagedProgram, WarmStart
from jaxscp.core.types import Scalar

LIBRARY = libraries.INTERIOR_POINT
(TARGET,) = LIBRARY.targets
MAX_GROUPS, MAX_CONES, MAX_LINES = 32, 256, 1 << 15  # of a node, as in ``layout.h``


def serves(program: StagedProgram) -> bool:
    """Whether the compiled loop takes this program, on a CPU."""
    return _numbers_fit(program) and LIBRARY.available()


def serves_on_gpu(program: StagedProgram) -> bool:
    """Whether the kernel takes this program, on the GPU that is JAX's default device."""
    return _numbers_fit(program) and gpu.available() and gpu.serves(program)


def _numbers_fit(program: StagedProgram) -> bool:
    cones = [c.offset.shape[1] for c in program.cones]
    few = len(cones) <= MAX_GROUPS and sum(cones) + 2 <= MAX_CONES
    links, rows = program.links.soft.shape[1], program.rows.offset.shape[1]
    lines = max(program.variables, links, rows, sum(math.prod(c.offset.shape[1:]) for c in program.cones))
    return libraries.in_float64(program) and few and lines <= MAX_LINES and links > 0


def call(program: StagedProgram, tolerance: Scalar, near: WarmStart | None = None, **settings: float | int):
    """Equilibrate and solve a program on a CPU.

    Args:
        program: in float64.
        tolerance: relative gap and residuals at which it counts as solved.
        near: where its solution is thought to be.
        settings: of the ``InteriorPoint``, by its own names.

    Returns:
        The arrays of the last iterate, (x, y, s, tau, kappa), in equilibrated units, then error, infeasibility,
        unboundedness, iterations, stalled, broken, and then the scales, in their order; the zero cone's slack, which is
        zero, is left out.
    """
    return _call(TARGET, program, tolerance, near, settings)


def call_on_gpu(
    program: StagedProgram, tolerance: Scalar, near: WarmStart | None = None, **settings: float | int
):
    """Equilibrate and solve a program on the GPU that is JAX's default device; see ``call``."""
    return _call(gpu.TARGET, program, tolerance, near, settings | gpu.attributes(program))


def _call(target: str, program: StagedProgram, tolerance: Scalar, near: WarmStart | None, attributes: dict):
    q, b = kkt.linear_cost(program), kkt.right_side(program)
    like = lambda v: jax.ShapeDtypeStruct(v.shape, v.dtype)  # noqa: E731
    scalar, flag = jax.ShapeDtypeStruct((), jnp.float64), jax.ShapeDtypeStruct((), jnp.bool_)
    vectors = [*map(like, (q.z, q.xi, q.zeta, b.zero, b.orthant, b.second, b.orthant, b.second))]
    count = jax.ShapeDtypeStruct((), jnp.int64)
    links, norm = program.links, program.norm
    arrays = [
        program.hessian,
        program.gradient,
        links.before,
        links.after,
        links.offset,
        links.soft,
        links.weight,
    ]
    arrays += [program.rows.matrix, program.rows.offset, tolerance]
    for cone in program.cones:
        arrays += [cone.matrix, cone.offset]
    if norm is not None:
        arrays += [norm.weight, norm.scale, norm.centre]
    if near is not None:
        arrays += [near.z, near.multipliers.links, near.multipliers.rows, *near.multipliers.cones]
    has = {"has_norm": np.int64(norm is not None), "has_near": np.int64(near is not None)}
    of_cones = [jax.ShapeDtypeStruct(c.offset.shape[:2], jnp.float64) for c in program.cones]
    scales = [*map(like, (program.gradient, links.offset, program.rows.offset)), *of_cones, scalar]
    results = [*vectors, *[scalar] * 5, count, flag, flag, *scales]
    solve = jax.ffi.ffi_call(target, results, vmap_method="broadcast_all")
    return solve(*arrays, **has, **attributes)
