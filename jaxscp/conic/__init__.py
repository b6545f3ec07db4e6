"""Solvers for the convex subproblem: our structured interior point, also as a layer, and OSQP on its quadratic form."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # the names of ``__init__.pyi``
