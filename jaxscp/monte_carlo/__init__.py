"""Monte Carlo: many cases of a problem that scatters, their storage, and statistics of what came of them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # what ``__init__.pyi`` lists
