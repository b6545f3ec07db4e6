"""Runge-Kutta integration over intervals: outputs, their Jacobian, and the Hessian of their weighted sum.

In the order in which the files build on each other:

    tableaus.py   Runge-Kutta methods
    intervals.py  intervals, their data and their outputs
    in_jax.py     integration in JAX, with its derivatives
    rate_tape.py  the rate as a tape
    in_cpp.py     integration in C++ for CPUs, which evaluates tapes; the C++ is in native/
    in_tape.py    integration in JAX, which evaluates the rate's tape, for GPUs without a kernel
    in_cuda.py    integration by one CUDA kernel, without path outputs; native/cuda_source.py writes its text
    interval_tapes.py   all functions of an interval as tapes
    in_cuda_blocks.py   integration by two CUDA kernels, with path outputs and second derivatives
    dispatch.py   choice of the implementation, with derivatives
"""
