"""Libraries in C++, which are compiled when the package is installed, one for each level of the instruction set.

What they share is here too:

    pack.h         a number for several places or intervals at once
    dense.h        products of small matrices, their rows in registers
    memory.h       arrays that serve again
    runs_here.cc   whether this machine has the instructions of a library
    spread.h       work shared among the threads of XLA
    driver.h       NVIDIA's driver, for what launches kernels on a GPU; ``cuda.py`` compiles those
"""

import ctypes
import functools
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

LEVELS = ("v4", "v3", "any")  # best first: two of x86-64, and what all machines of a kind have


def in_float64(tree: Any) -> bool:
    """Whether every array is of the only numbers that C++ takes; of others it would read nonsense."""
    return all(leaf.dtype == jnp.float64 for leaf in jax.tree.leaves(tree))


def choose(
    cpu: Callable[..., Any] | None,
    elsewhere: Callable[..., Any],
    *args: Any,
    cuda: Callable[..., Any] | None = None,
) -> Any:
    """Call the function of the device; that of other devices is not even traced where there are none.

    Args:
        cpu: what was compiled for CPUs, if anything was.
        elsewhere: the same as JAX.
        args: of all.
        cuda: what was compiled for the GPU that is JAX's default device, if anything was.
    """
    if cpu is not None and jax.default_backend() == "cpu":
        return cpu(*args)
    compiled = {name: found for name, found in (("cpu", cpu), ("cuda", cuda)) if found is not None}
    return jax.lax.platform_dependent(*args, **compiled, default=elsewhere) if compiled else elsewhere(*args)


class Library(NamedTuple):
    """What was compiled of one part of the package, if a compiler was found at its installation."""

    stem: Path
    """Of its files, ``stem_level.so``."""
    targets: tuple[str, ...]
    """What XLA calls on a CPU."""
    on_gpu: str = ""
    """What it calls on an NVIDIA GPU to launch a kernel, if there is one; of the same files."""

    def available(self) -> bool:
        """Whether it was compiled for this machine; makes its targets known to XLA."""
        return self.level() is not None

    def level(self) -> str | None:
        """The instruction set that it is compiled for here, if it is; see ``LEVELS``."""
        found = [level(self.stem, target) for target in self.targets]
        return found[0] if all(found) else None


_PACKAGE = Path(__file__).parents[1]
HEADERS = Path(__file__).parent / "native"
INTERIOR_POINT = Library(
    _PACKAGE / "conic/native/interior_point",
    ("jaxscp_interior_point",),
    "jaxscp_interior_point_on_gpu",
)
NORMAL = Library(_PACKAGE / "linalg/gram/native/normal", ("jaxscp_normal",))
RICCATI = Library(
    _PACKAGE / "linalg/riccati/native/riccati", ("jaxscp_riccati_factor", "jaxscp_riccati_solve")
)
SEMIDEFINITE = Library(
    _PACKAGE / "linalg/eigen/native/semidefinite", ("jaxscp_nearest_semidefinite", "jaxscp_eigen")
)
SWEEP = Library(_PACKAGE / "integration/native/sweep", ("jaxscp_sweep",), "jaxscp_sweep_on_gpu")
EVERY = (INTERIOR_POINT, NORMAL, RICCATI, SEMIDEFINITE, SWEEP)


@functools.cache
def level(stem: Path, handler: str, platform: str = "cpu") -> str | None:
    """The best level that was compiled and runs here, whose handler XLA then knows by its own name; None without one.

    Args:
        stem: of the libraries' files, ``stem_level.so``.
        handler: what is to be called.
        platform: where, by XLA's name.
    """
    for name in LEVELS:
        if (found := library(stem, name)) is not None:
            return name if register(found, handler, platform) else None
    return None


@functools.cache
def library(stem: Path, level: str) -> ctypes.CDLL | None:
    """The library for an instruction set, if it was compiled and this machine has that."""
    file = stem.with_name(f"{stem.name}_{level}.so")
    if not file.exists():
        return None
    found = ctypes.CDLL(str(file))
    return found if found.jaxscp_runs_here() else None


def register(library: ctypes.CDLL, handler: str, platform: str = "cpu", target: str | None = None) -> bool:
    """Make a compiled handler known to XLA, by its own name or another; warns where it does not fit."""
    try:
        capsule = jax.ffi.pycapsule(getattr(library, handler))
        jax.ffi.register_ffi_target(target or handler, capsule, platform=platform)
    except Exception as error:  # XLA's own types, which differ by version
        warnings.warn(
            f"jaxscp: what was compiled at its installation does not fit this jaxlib, and is left out ({error}); "
            "install jaxscp again to compile it anew",
            stacklevel=2,
        )
        return False
    return True
