"""One pass through the intervals of a flight: what they give, its Jacobian, and the curvature of its priced sum.

In the order in which they build on each other:

    intervals.py  what a pass goes through, and what it finds
    in_jax.py     the pass as JAX differentiates it
    symbols.py    arithmetic on numbers that are not known yet
    tracing.py    from a function of arrays to the operations on numbers that it is made of
    tape.py       those operations in order, with a place for each number
    functions.py  the tapes of a function and its derivatives
    compiled.py   the pass in C++, which plays such tapes, for CPUs; native/ is the C++
    played.py     the pass in JAX that plays them, for other devices
    launch.py     kernels for NVIDIA GPUs, made of them, whatever they do; native/statements.py writes what is of a tape
    kernel.py     the pass as such a kernel; native/source.py writes it
    passes.py     which of these is taken
"""
