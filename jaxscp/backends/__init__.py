"""Compiled libraries, CUDA kernels, and functions written as C++ or CUDA."""
