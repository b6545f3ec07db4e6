"""Monte Carlo sweeps: cases of a problem whose numbers scatter, their storage, and statistics of the results."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # what ``__init__.pyi`` lists
