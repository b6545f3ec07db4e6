"""The public ``load``: solutions from a file."""

import os
from collections.abc import Iterable
from typing import TYPE_CHECKING

from jaxscp.aot import load as aot_load

if TYPE_CHECKING:
    from jaxscp.aot.aot import CompiledPlanner
    from jaxscp.solver.compiled import CompiledSolver


def load(file: str | os.PathLike, *, compile: bool = True) -> "CompiledPlanner | CompiledSolver":
    """What ``Planner.export`` or ``Solver.export`` wrote; it traces nothing, and on its own machine compiles nothing.

    The file holds machine code, which a call runs: load only files that you would run as a program. The code is used if
    jax, jaxlib, device and the processor's instruction sets are the same as at the export; solutions then equal the
    planner's bitwise. Elsewhere the portable form in the file is compiled (``jaxscp.use_cache`` stores the result).
    A planner that calls the compiled libraries needs them here too, and on a GPU a device of the same model.

    Args:
        file: its name.
        compile: whether the portable form may be compiled; if not, a file from another machine is an error.

    Raises:
        InvalidExport: if the file is no such file, of another format or for another platform, or JAX is in float32.
        OSError: if the file cannot be read.
    """
    compiled = load_planner(file, compile=compile)
    if "entries" not in compiled.scenario:
        return compiled
    from jaxscp.solver.compiled import CompiledSolver  # of a file that ``Solver.export`` wrote

    return CompiledSolver(compiled, compiled.scenario)


def load_planner(file: str | os.PathLike, *, compile: bool = True) -> "CompiledPlanner":
    """The compiled programs in a file."""
    return aot_load.load(file, _solution_classes, compile=compile)


def _solution_classes() -> Iterable[type]:
    """Classes of a solution's pytree."""
    from jaxscp.backends.serving import Backends
    from jaxscp.dynamics.augmented import DYNAMICS
    from jaxscp.problem.multipliers import Multipliers
    from jaxscp.problem.trajectory import Trajectory
    from jaxscp.scp.history import History
    from jaxscp.solver.solution import Solution
    from jaxscp.verification.certificate import Certificate

    return Solution, Trajectory, Multipliers, Certificate, History, Backends, *DYNAMICS
