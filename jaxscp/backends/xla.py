"""How XLA compiles planners: for a CPU as quickly as it can, for a GPU so that it launches what it can by itself."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.core import Tracer

QUICKLY: dict[str, Any] = {"xla_cpu_use_fusion_emitters": False}
"""A planner is many small operations, and to emit them fused takes two fifths of the time to compile it for a CPU,
without a plan being any faster. From jax 0.12 on there is no such choice."""

AS_GRAPHS: dict[str, Any] = {
    "xla_gpu_enable_command_buffer": (
        "FUSION,CUBLAS,CUBLASLT,CUSTOM_CALL,CUDNN,DYNAMIC_SLICE_FUSION,WHILE,CONDITIONAL"
    ),
    "xla_gpu_graph_min_graph_size": 1,
}
"""Loops too become graphs of a GPU, which launches them itself: of one plan, most of the time goes into launches."""


@functools.cache
def options() -> dict[str, Any]:
    """``compiler_options`` for what JAX compiles; those alone that this version knows."""
    wanted = {"cpu": QUICKLY, "gpu": AS_GRAPHS}.get(jax.default_backend(), {})
    try:
        jax.jit(lambda v: v, compiler_options=wanted).lower(jax.ShapeDtypeStruct((), float)).compile()
    except Exception:  # XLA's own types, which differ by version
        return {}
    return wanted


class jit_with_options:
    """``jax.jit``, with these options where a call is compiled by itself and is not part of another program.

    A decorator.

    Args:
        function: of arrays; left as ``function``.
        static_argnums: as for ``jax.jit``.
    """

    def __init__(self, function: Callable[..., Any], static_argnums: int) -> None:
        self.function = function
        self._static = static_argnums
        self._part = jax.jit(function, static_argnums=static_argnums)

    def __call__(self, *args: Any) -> Any:
        """Call the function."""
        return (self._part if is_traced(args) else self._program)(*args)

    @functools.cached_property
    def _program(self) -> Callable[..., Any]:
        return jax.jit(self.function, static_argnums=self._static, compiler_options=options())


def is_traced(args: Any) -> bool:
    """Whether a call with these arguments is part of another program, or of a transformation."""
    leaves = [jnp.zeros(()), *jax.tree.leaves(args)]  # under ``jit`` even the zero is traced
    return any(isinstance(leaf, Tracer) for leaf in leaves)
