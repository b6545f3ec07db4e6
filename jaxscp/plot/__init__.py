"""Pictures of a plan: its path, its histories, and the convergence of the iterations.

``summary``, ``scene`` and ``histories`` make figures; all other functions draw on axes that they are given and return
them. Nothing here touches pyplot, so that importing and plotting change no global state. Lines between nodes are the
flight that the certificate flies (controls integrated again, no correction), not an interpolation: where a plan cuts a
corner between two nodes, the picture shows it. Dots are the planned nodes.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # the names of ``__init__.pyi``
