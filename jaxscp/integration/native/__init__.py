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
    interval_source.py  text before ``intervals.cu``, from tapes; ``in_cuda_blocks.py`` compiles both
    interval.cuh        arrays of an interval, and the work of threads
    interval_path.cuh, interval_adjoints.cuh, interval_columns.cuh
                        the same as ``forward.h``, ``adjoint.h`` and ``tangents.h``, by a block of threads
    intervals.cu        the kernel
    gpu_handler.cc      XLA FFI handler that launches kernels
"""

from jaxscp.backends import libraries

LIBRARY = libraries.INTEGRATION
(TARGET,) = LIBRARY.targets
