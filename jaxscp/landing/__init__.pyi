# Imported on first use: see ``__init__.py``.

from . import scenarios as scenarios
