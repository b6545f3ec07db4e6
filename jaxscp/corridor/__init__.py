"""Safe flight corridors: half-space polytopes, and how to make them from a point cloud."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # what ``__init__.pyi`` lists
