"""Ruiz's scales in C++, for float64 on a CPU: those of ``conic.equilibrate``, to rounding."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxscp import libraries
from jaxscp.conic.program import StagedProgram

LIBRARY = libraries.INTERIOR_POINT
_, TARGET = LIBRARY.targets


def scales(program: StagedProgram, rounds: int) -> list[jax.Array]:
    """Of columns, links, rows, every group of cones, and the cost."""
    links = program.links
    arrays = [program.hessian, program.gradient, links.before, links.after, links.soft, program.rows.matrix]
    if program.norm is not None:
        arrays.append(program.norm.weight)
    arrays += [cone.matrix for cone in program.cones]
    of_cones = [cone.offset.shape[:2] for cone in program.cones]
    shapes = [program.gradient.shape, links.offset.shape, program.rows.offset.shape, *of_cones, ()]
    call = jax.ffi.ffi_call(
        TARGET, [jax.ShapeDtypeStruct(s, jnp.float64) for s in shapes], vmap_method="broadcast_all"
    )
    return list(call(*arrays, has_norm=np.int64(program.norm is not None), rounds=np.int64(rounds)))
