"""Integration to a tolerance by an adaptive eighth-order method, for the verifier.

    integrate.py    dispatch
    accuracy.py     tolerance and step limits
    method.py       tableau of Dormand and Prince
    in_jax.py       by diffrax
    in_cuda.py      by a kernel for NVIDIA GPUs; ``cuda_source.py`` writes its text from the dynamics' tape

The solver uses neither this method nor this code. The two share only the generation of kernels from dynamics, whose
result is compared with the dynamics.
"""
