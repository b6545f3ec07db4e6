"""Differentiable six-degree-of-freedom trajectory optimisation by sequential convex programming."""

import lazy_loader

from jaxscp.core.version import __version__ as __version__

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # what ``__init__.pyi`` lists
