"""A planner in a file: its header, its programs in portable form, and as compiled for one machine.

The file is a ZIP archive: ``header.json``, ``*.stablehlo`` (serialised by ``jax.export``) and ``*.executable``
(serialised by ``jax.experimental.serialize_executable``, which pickles). ``export`` writes it. The code that reads it
is here and in ``load``, and imports little: threads load the programs while the other modules are imported
(``rebuild``).
"""

import hashlib
import json
import os
import pathlib
import platform
import zipfile
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import jaxlib
from jax.experimental import serialize_executable

from jaxscp.aot.notes import without_false_alarms
from jaxscp.backends import libraries

FORMAT = 17
PROGRAMS = ("setup", "solve", "conclude")
COMPILED = (
    *(library.on_gpu for library in libraries.EVERY if library.on_gpu),
    *(target for library in libraries.EVERY for target in library.targets),
)
"""Targets of the compiled libraries, which programs may call."""


class InvalidExport(ValueError):
    """A file is no planner that can be loaded here; the message says why."""


class Archive(NamedTuple):
    """Contents of a file."""

    header: dict[str, Any]
    portable: dict[str, bytes]
    executable: dict[str, bytes]


def read(file: str | os.PathLike) -> Archive:
    """Contents of a file that ``export.write`` wrote.

    Raises:
        InvalidExport: if the file is something else, or of another format.
    """
    try:
        with zipfile.ZipFile(file) as archive:
            header = json.loads(archive.read("header.json"))
            if header["format"] != FORMAT:
                raise InvalidExport(
                    f"{file}: its format is {header['format']}, and this version of jaxscp reads {FORMAT}; export the "
                    "planner again."
                )
            names = archive.namelist()
            portable = {
                name: archive.read(f"{name}.stablehlo") for name in PROGRAMS if f"{name}.stablehlo" in names
            }
            return Archive(header, portable, {name: archive.read(f"{name}.executable") for name in PROGRAMS})
    except (zipfile.BadZipFile, KeyError, TypeError, json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InvalidExport(f"{file}: not a planner that Planner.export wrote: {error}") from error


def fingerprint() -> dict[str, str]:
    """Versions and hardware that a compiled program needs, and nothing else."""
    device = jax.devices()[0]
    return {
        "jax": jax.__version__,
        "jaxlib": jaxlib.__version__,
        "device": device.device_kind,
        "runtime": device.client.platform_version,
        "host": platform.machine(),
        "instructions": hashlib.sha256(_instructions().encode()).hexdigest(),
        "compiled": " ".join(str(library.level()) for library in libraries.EVERY),
    }


def is_here(target: str) -> bool:
    """Whether this installation has the library of a target; registers the target with XLA."""
    for library in libraries.EVERY:
        if target == library.on_gpu:
            from jaxscp.backends import cuda  # for a GPU alone

            return cuda.launches(library)
        if target in library.targets:
            return library.available()
    return False


def _instructions() -> str:
    """The processor's instruction sets where the system lists them, else the host's name."""
    table = pathlib.Path("/proc/cpuinfo")
    lines = table.read_text().splitlines() if table.exists() else []
    found = {line for line in lines if line.startswith(("flags", "Features"))}
    return "\n".join(sorted(found)) or platform.node()


def start_loading(archive: Archive) -> dict[str, Future[Callable]]:
    """Load the compiled programs, each in a thread of its own; no compiler runs."""
    device = jax.devices()[0]

    def load(name: str) -> Callable:
        with without_false_alarms():
            return serialize_executable.deserialize_and_load(
                archive.executable[name],
                jax.tree.structure(((0,) * archive.header["arguments"][name], {})),
                jax.tree.structure([0] * archive.header["results"][name]),
                execution_devices=[device],
            )

    threads = ThreadPoolExecutor()
    loading = {name: threads.submit(load, name) for name in sorted(PROGRAMS, key=lambda n: n != "solve")}
    threads.shutdown(wait=False)
    return loading


def find_lapack() -> None:
    """Have JAX look up LAPACK's routines.

    JAX does so when it first lowers a program with one; in a process that only runs programs, the routines would be
    null pointers.
    """
    jax.jit(jax.lax.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), float))
