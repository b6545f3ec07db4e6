"""Errors of a sweep, and packages that only sweeps need."""

import importlib
from typing import Any


class InvalidStudy(ValueError):
    """A study contradicts itself; the message names the field and the likely cause."""


class SweepError(RuntimeError):
    """A sweep cannot be written, read or continued; the message says what to do."""


def extra(module: str, name: str = "sweeps") -> Any:
    """A module of an extra, imported on first use.

    Args:
        module: to import; ``"zarr"``, say.
        name: of the extra of jaxscp that installs it.

    Raises:
        ImportError: if it is missing; the message has the command that installs it.

    Example:
        >>> extra("no_such_module")
        Traceback (most recent call last):
        ImportError: sweeps need the package no_such_module: pip install 'jaxscp[sweeps]'
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise ImportError(f"sweeps need the package {package}: pip install 'jaxscp[{name}]'") from error
