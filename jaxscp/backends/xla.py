"""XLA compiler options: short compile time on a CPU, few launches on a GPU."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.core import Tracer

CPU_OPTIONS: dict[str, Any] = {
    "xla_cpu_use_fusion_emitters": False,
    "xla_cpu_parallel_codegen_split_count": 8,
}
"""Fusion emitters take two fifths of a planner's compile time and make no plan faster. From jax 0.12 on, XLA has no
such option. Machine code in 8 parts, not 32, holds a third fewer memory mappings, of which a process may have so many
only; it compiles no slower."""

GPU_OPTIONS: dict[str, Any] = {
    "xla_gpu_enable_command_buffer": (
        "FUSION,CUBLAS,CUBLASLT,CUSTOM_CALL,CUDNN,DYNAMIC_SLICE_FUSION,WHILE,CONDITIONAL"
    ),
    "xla_gpu_graph_min_graph_size": 1,
}
"""Loops, too, become CUDA graphs: launches take most of a single plan's time."""


def compiler_options() -> dict[str, Any]:
    """Options of ``jax.jit`` with which your own programs around a planner compile as fast as the planner's own.

    For the default backend, without those that this version of XLA rejects. JAX takes options at the outermost ``jit``
    only.

    Example:
        >>> import jax, jaxscp
        >>> study = jax.jit(lambda x: 2.0 * x, compiler_options=jaxscp.compiler_options())
        >>> float(study(1.5))
        3.0
    """
    return dict(_options())  # a copy: callers may add options of their own


@functools.cache
def _options() -> dict[str, Any]:
    candidates = {"cpu": CPU_OPTIONS, "gpu": GPU_OPTIONS}.get(jax.default_backend(), {})
    if _accepted(candidates):
        return candidates
    return {name: value for name, value in candidates.items() if _accepted({name: value})}


def _accepted(candidates: dict[str, Any]) -> bool:
    """Whether XLA compiles with these options."""
    try:
        jax.jit(lambda v: v, compiler_options=candidates).lower(jax.ShapeDtypeStruct((), float)).compile()
    except Exception:  # XLA's own types, which differ by version
        return False
    return True


class jit_with_options:
    """``jax.jit`` with ``compiler_options()`` for calls at the top level; calls that are traced use plain ``jax.jit``.

    A decorator.

    Args:
        function: function of arrays; stored as the attribute ``function``.
        static_argnums: as for ``jax.jit``.
    """

    def __init__(self, function: Callable[..., Any], static_argnums: int) -> None:
        self.function = function
        self._static = static_argnums
        self._traced = jax.jit(function, static_argnums=static_argnums)

    def __call__(self, *args: Any) -> Any:
        """Result of the function."""
        return (self._traced if is_traced(args) else self._compiled)(*args)

    @functools.cached_property
    def _compiled(self) -> Callable[..., Any]:
        return jax.jit(self.function, static_argnums=self._static, compiler_options=compiler_options())


def is_traced(args: Any) -> bool:
    """Whether a call with these arguments is part of another program, or of a transformation."""
    leaves = [jnp.zeros(()), *jax.tree.leaves(args)]  # under ``jit`` even the zero is traced
    return any(isinstance(leaf, Tracer) for leaf in leaves)


def any_rank(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function whose own code may broadcast between ranks, where JAX is set to refuse that.

    The setting ``jax_numpy_rank_promotion`` is for the user's functions, which are traced before.

    Example:
        >>> import jax, jax.numpy as jnp
        >>> from jaxscp.backends.xla import any_rank
        >>> with jax.numpy_rank_promotion("raise"):
        ...     any_rank(lambda: jnp.ones((2, 2)) + jnp.ones(2))().shape
        (2, 2)
    """

    @functools.wraps(function)
    def call(*arguments: Any, **named: Any) -> Any:
        if jax.config.jax_numpy_rank_promotion == "allow":  # pyright: ignore[reportAttributeAccessIssue]
            return function(*arguments, **named)
        with jax.numpy_rank_promotion("allow"):
            return function(*arguments, **named)

    return call
