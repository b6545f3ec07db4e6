"""Errors of a sweep, and packages that only sweeps need."""

from typing import Any

from jaxscp.core.extras import of_extra


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
    return of_extra(module, name, f"sweeps need the package {module.partition('.')[0]}")
