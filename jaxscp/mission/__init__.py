"""A mission: from the deck, through obstacles, and back onto the deck (extras ``simulation``, ``clouds``)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # the names of ``__init__.pyi``
