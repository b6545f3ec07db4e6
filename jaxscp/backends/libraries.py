"""Compiled C++ libraries: one file for each library and instruction set, built when the package is installed.

Headers shared by all of them are in ``native/``:

    pack.h          SIMD register of float64
    dense.h         products of small matrices, whose rows are in registers
    workspace.h     arrays that are allocated once and used again
    runs_here.cc    check of this machine's instruction set; digest of the sources
    parallel_for.h  loops over XLA's thread pool
    tensor_cores.h  products of small matrices, on a GPU
    dynamic_memory.cuh  shared memory of a block of threads on a GPU
    driver.h        NVIDIA's driver, which launches kernels; ``cuda.py`` compiles those
    launch.h        launch of a kernel with any arguments and results; ``launch.py`` calls it
"""

import ctypes
import functools
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxscp.backends.serving import index_of, warn_slow
from jaxscp.backends.sources import SHARED, digest

LEVELS = ("v4", "v3", "any")
"""Instruction sets, best first: x86-64-v4, x86-64-v3, and the compiler's default."""

OTHER_JAXLIB = "refused by this jaxlib: install jaxscp again"
OTHER_SOURCES = "older than its sources: install jaxscp again"
OTHER_PROCESSORS = "compiled for other processors: install jaxscp again on this machine"
NOT_COMPILED = "not compiled: install a C++ compiler, then jaxscp again"
REASONS = OTHER_JAXLIB, OTHER_SOURCES, OTHER_PROCESSORS, NOT_COMPILED
"""Why a library does not serve; of several instruction sets, the first that applies to one is told."""


def in_float64(tree: Any) -> bool:
    """Whether every array is float64, the only type that the C++ reads."""
    return all(leaf.dtype == jnp.float64 for leaf in jax.tree.leaves(tree))


def dispatch(
    cpu: Callable[..., Any] | None,
    default: Callable[..., Any],
    *args: Any,
    cuda: Callable[..., Any] | None = None,
) -> Any:
    """Result of the implementation for the device that runs the program.

    Implementations for absent devices are not traced.

    Args:
        cpu: compiled implementation for CPUs; None if there is none.
        default: implementation in JAX.
        args: arguments of every implementation.
        cuda: compiled implementation for the GPU that is JAX's default device; None if there is none.
    """
    if cpu is not None and jax.default_backend() == "cpu":
        return cpu(*args)
    compiled = {name: found for name, found in (("cpu", cpu), ("cuda", cuda)) if found is not None}
    return jax.lax.platform_dependent(*args, **compiled, default=default) if compiled else default(*args)


def serving(*, cpp: bool, cuda: bool) -> Int[Array, ""]:
    """Index into ``BACKENDS`` of the implementation that ``dispatch`` chooses.

    Args:
        cpp: whether there is compiled C++, for a CPU.
        cuda: whether there is a kernel, for an NVIDIA GPU.
    """
    jax_, cpp_, cuda_ = (functools.partial(index_of, name) for name in ("JAX", "C++", "CUDA"))
    return dispatch(cpp_ if cpp else None, jax_, cuda=cuda_ if cuda else None)


class Library(NamedTuple):
    """A compiled library; its files exist only if a C++ compiler was found at installation."""

    stem: Path
    """Path of the files without suffix: ``stem_level.so``."""
    targets: tuple[str, ...]
    """XLA FFI targets on a CPU: the names of C++ symbols."""
    on_gpu: str = ""
    """XLA FFI target in the same files that launches a CUDA kernel; empty if there is no kernel."""

    def available(self) -> bool:
        """Whether the library was compiled for this machine; registers its targets with XLA."""
        return self.level() is not None

    def level(self) -> str | None:
        """Instruction set that is used here, one of ``LEVELS``; None if the library was not compiled."""
        found = [level(self.stem, target) for target in self.targets]
        return found[0] if all(found) else None

    def reason(self) -> str:
        """Why the library does not serve; empty if it does."""
        if self.available():
            return ""
        reasons = {_opened(self.stem, name)[1] or OTHER_JAXLIB for name in LEVELS}
        return next(reason for reason in REASONS if reason in reasons)


_PACKAGE = Path(__file__).parents[1]
HEADERS = SHARED
INTERIOR_POINT = Library(
    _PACKAGE / "conic/native/interior_point",
    ("jaxscp_interior_point",),
    "jaxscp_interior_point_on_gpu",
)
GRAM = Library(_PACKAGE / "linalg/gram/native/gram", ("jaxscp_gram",), "jaxscp_gram_on_gpu")
RICCATI = Library(
    _PACKAGE / "linalg/riccati/native/riccati",
    ("jaxscp_riccati_factor", "jaxscp_riccati_solve"),
    "jaxscp_riccati_on_gpu",
)
EIGEN = Library(
    _PACKAGE / "linalg/eigen/native/eigen",
    ("jaxscp_nearest_semidefinite", "jaxscp_eigen"),
    "jaxscp_eigen_on_gpu",
)
INTEGRATION = Library(
    _PACKAGE / "integration/native/integration", ("jaxscp_integrate",), "jaxscp_integrate_on_gpu"
)
EVERY = (INTERIOR_POINT, GRAM, RICCATI, EIGEN, INTEGRATION)


@functools.cache
def level(stem: Path, handler: str, platform: str = "cpu") -> str | None:
    """Best instruction set that was compiled and runs here; None if there is none. Registers the handler with XLA.

    Args:
        stem: path of the library's files without suffix.
        handler: name of the C++ symbol, and of the XLA FFI target.
        platform: XLA's name of the platform.
    """
    for name in LEVELS:
        if (found := library(stem, name)) is not None:
            return name if register(found, handler, platform) else None
    reasons = {_opened(stem, name)[1] for name in LEVELS}
    if reasons == {NOT_COMPILED}:
        warn_slow(
            "no compiled C++ is installed, and JAX is up to 13 times slower; install a C++ compiler (GCC 12, Clang 15, "
            "or newer), then jaxscp again"
        )
    elif reasons <= {NOT_COMPILED, OTHER_PROCESSORS}:
        warn_slow(
            "the compiled C++ needs instructions that this processor lacks, and JAX is up to 13 times slower; install "
            "jaxscp again on this machine"
        )
    return None


@functools.cache
def library(stem: Path, level: str) -> ctypes.CDLL | None:
    """Library for an instruction set; None if it was not compiled or this machine lacks the instructions.

    Also None, with a warning, if the library was compiled from other sources than the present ones: such a library may
    expect other arguments.
    """
    found, reason = _opened(stem, level)
    if reason == OTHER_SOURCES:
        warnings.warn(
            "jaxscp: the compiled C++ is older than its sources and is not used, and jaxscp is slower; "
            "install jaxscp again to compile it again",
            stacklevel=2,
        )
    return found


def _opened(stem: Path, level: str) -> tuple[ctypes.CDLL | None, str]:
    """Library for an instruction set and no reason, or None and the reason why it cannot serve."""
    file = _file(stem, level)
    if not file.exists():
        return None, NOT_COMPILED
    found = ctypes.CDLL(str(file))
    if not found.jaxscp_runs_here():
        return None, OTHER_PROCESSORS
    if compiled_from(found) != digest(stem.parent):
        return None, OTHER_SOURCES
    return found, ""


def _file(stem: Path, level: str) -> Path:
    return stem.with_name(f"{stem.name}_{level}.so")


def compiled_from(library: ctypes.CDLL) -> str:
    """Digest of the sources that a loaded library was compiled from; empty if the library does not carry it."""
    function = getattr(library, "jaxscp_sources", None)
    if function is None:
        return ""
    function.restype = ctypes.c_char_p
    return function().decode()


def register(library: ctypes.CDLL, handler: str, platform: str = "cpu", target: str | None = None) -> bool:
    """Whether XLA accepts a compiled handler as FFI target; warns if XLA refuses.

    Args:
        library: loaded library.
        handler: name of the C++ symbol.
        platform: XLA's name of the platform.
        target: name of the FFI target; the handler's by default.
    """
    try:
        capsule = jax.ffi.pycapsule(getattr(library, handler))
        jax.ffi.register_ffi_target(target or handler, capsule, platform=platform)
    except Exception as error:  # XLA's own types, which differ by version
        warnings.warn(
            f"jaxscp: the compiled C++ does not match this jaxlib and is not used ({error}); "
            "install jaxscp again to compile it again",
            stacklevel=2,
        )
        return False
    return True
