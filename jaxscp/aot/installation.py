"""Facts about an installation: versions, devices, which compiled libraries serve and why others do not, the cache."""

import platform
import warnings
from typing import Any

import jax

from jaxscp.aot.cache_folder import folder
from jaxscp.backends import cuda, libraries
from jaxscp.core.version import __version__


def installation() -> dict[str, Any]:
    """Versions, devices, compiled libraries and the cache, as an object that JSON can hold.

    Example:
        >>> from jaxscp.aot.installation import installation
        >>> sorted(installation())
        ['cache', 'devices', 'jax', 'libraries', 'python', 'version']
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the reasons below say the same
        served = {library.stem.name: _library(library) for library in libraries.EVERY}
    return {
        "version": __version__,
        "python": platform.python_version(),
        "jax": jax.__version__,
        "devices": [f"{device.platform}:{device.id} {device.device_kind}" for device in jax.devices()],
        "libraries": served,
        "cache": None if folder() is None else str(folder()),
    }


def _library(library: libraries.Library) -> dict[str, Any]:
    """Instruction set that serves on the CPU, whether a kernel serves on the GPU, and the reason if JAX serves."""
    facts: dict[str, Any] = {"serves": library.available(), "instructions": library.level()}
    if not facts["serves"]:
        facts["reason"] = library.reason()
    if jax.default_backend() == "gpu":
        facts["kernel"] = cuda.launches(library) and cuda.compiler() is not None
    return facts
