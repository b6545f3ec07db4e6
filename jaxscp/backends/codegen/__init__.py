"""Array functions as lists of scalar operations (tapes), evaluated by C++ or JAX or written as CUDA text."""
