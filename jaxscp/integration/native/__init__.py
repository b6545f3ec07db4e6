"""Integration in C++, compiled for this machine, and the texts of CUDA kernels.

In the order in which the files build on each other:

    tape.h              operations on numbers, for two packs of intervals at once
    functions.h         a function and its derivatives, as tapes
    interval_problem.h  description of the integration
    description.h       reader of the description
    forward.h           path and outputs
    adjoint.h           adjoints of slopes and points, from the multipliers of the outputs
    tangents.h          Jacobian, and Hessian of the weighted sum
    handler.cc          XLA FFI handler on a CPU
    cuda_source.py      text of the kernel without path outputs, from a tape; ``in_cuda.py`` compiles it
    function_source.py  text of a function and its derivatives, from tapes
    interval_source.py  text before ``paths.cu`` and ``intervals.cu``, from tapes; ``in_cuda_blocks.py`` compiles both
    interval.cuh        sizes of an interval, and numbers that one kernel stores for the other
    interval_path.cuh   the same as ``forward.h`` and ``adjoint.h``, by one thread
    hessian_tiles.cuh   the Hessian, in the registers of a warp's tensor cores
    interval_columns.cuh    the same as ``tangents.h``, by a block of threads
    paths.cu            the kernel of the paths, with a thread for each interval
    intervals.cu        the kernel of the derivatives, with a block for each interval
    gpu_handler.cc      XLA FFI handler that launches kernels
"""

from jaxscp.backends import libraries

LIBRARY = libraries.INTEGRATION
(TARGET,) = LIBRARY.targets
