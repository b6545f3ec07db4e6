"""Functions of arrays as lists of scalar operations, and these as CUDA text."""
