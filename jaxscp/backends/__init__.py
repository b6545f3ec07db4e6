"""Compiled libraries, CUDA kernels, and translation of array functions to C++ or CUDA."""
