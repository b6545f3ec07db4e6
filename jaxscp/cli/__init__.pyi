# Imported on first use: see ``__init__.py``.

from .app import app as app
from .app import main as main
