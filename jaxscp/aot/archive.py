"""A planner in a file: what it is for, its programs in portable form, and as compiled for one machine.

The file is a ZIP archive: ``header.json``, ``*.stablehlo`` (serialised by ``jax.export``) and ``*.executable``
(serialised by ``jax.experimental.serialize_executable``, which pickles). ``exporting`` writes it. What reads it is
here and in ``loading``, and imports little, so that programs are loaded while the rest is imported (``loaded``).
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

from jaxscp.backends import libraries

FORMAT = 10
PROGRAMS = ("setup", "solve", "conclude")
COMPILED = (
    *(library.on_gpu for library in libraries.EVERY if library.on_gpu),
    *(target for library in libraries.EVERY for target in library.targets),
)
"""What programs may call that was compiled at installation."""


class InvalidExport(ValueError):
    """A file is no planner that can be loaded here; the message says why."""


class Archive(NamedTuple):
    """What a file holds."""

    header: dict[str, Any]
    portable: dict[str, bytes]
    executable: dict[str, bytes]


def read(file: str | os.PathLike) -> Archive:
    """What ``exporting.write`` wrote; raises ``InvalidExport`` if it is something else."""
    try:
        with zipfile.ZipFile(file) as archive:
            header = json.loads(archive.read("header.json"))
            if header["format"] != FORMAT:
                raise InvalidExport(
                    f"{file}: its format is {header['format']}, and this version of jaxscp reads {FORMAT}; export the "
                    "planner again."
                )
            forms = [name for name in PROGRAMS if f"{name}.stablehlo" in archive.namelist()]
            portable = {name: archive.read(f"{name}.stablehlo") for name in forms}
            return Archive(header, portable, {name: archive.read(f"{name}.executable") for name in PROGRAMS})
    except (zipfile.BadZipFile, KeyError, TypeError, json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InvalidExport(f"{file}: not a planner that Planner.export wrote: {error}") from error


def machine() -> dict[str, str]:
    """What a compiled program runs on: that and nothing else."""
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
    """Whether what a program calls was compiled at this installation; makes it known to XLA."""
    for library in libraries.EVERY:
        if target == library.on_gpu:
            from jaxscp.backends import cuda  # for a GPU alone

            return cuda.launches(library)
        if target in library.targets:
            return library.available()
    return False


def _instructions() -> str:
    """The processor's instruction sets where the system tells, else the host's name."""
    table = pathlib.Path("/proc/cpuinfo")
    lines = table.read_text().splitlines() if table.exists() else []
    found = {line for line in lines if line.startswith(("flags", "Features"))}
    return "\n".join(sorted(found)) or platform.node()


def begin(archive: Archive) -> dict[str, Future[Callable]]:
    """Load the programs as they were compiled, each in a thread of its own; no compiler runs."""
    device = jax.devices()[0]

    def load(name: str) -> Callable:
        return serialize_executable.deserialize_and_load(
            archive.executable[name],
            jax.tree.structure(((0,) * archive.header["arguments"][name], {})),
            jax.tree.structure([0] * archive.header["results"][name]),
            execution_devices=[device],
        )

    threads = ThreadPoolExecutor()
    begun = {name: threads.submit(load, name) for name in sorted(PROGRAMS, key=lambda name: name != "solve")}
    threads.shutdown(wait=False)
    return begun


def find_lapack() -> None:
    """Have JAX look up LAPACK's routines: it does so when it first lowers a program with one, and in a process that
    only runs programs they would be null pointers."""
    jax.jit(jax.lax.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), float))
