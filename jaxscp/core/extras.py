"""Packages of optional extras, imported on first use."""

import contextlib
import io
from importlib import import_module
from typing import Any


def of_extra(module: str, extra: str, purpose: str) -> Any:
    """A module of an extra.

    Args:
        module: to import; ``"zarr"``, say.
        extra: of jaxscp that installs it.
        purpose: begins the message, ``"sweeps need the package zarr"``, say.

    Raises:
        ImportError: if it is missing; the message has the command that installs it.

    Example:
        >>> of_extra("no_such_module", "clouds", "the search needs it")
        Traceback (most recent call last):
        ImportError: the search needs it: pip install 'jaxscp[clouds]'
    """
    try:
        with contextlib.redirect_stdout(
            io.StringIO()
        ):  # some print that they miss a package, and can do without
            return import_module(module)
    except ImportError as error:
        raise ImportError(f"{purpose}: pip install 'jaxscp[{extra}]'") from error
