"""CUDA kernels compiled for a CPU, where one core runs all threads."""

import ctypes
import functools
import shutil
import subprocess
import tempfile
from pathlib import Path

import jax
import pytest

from jaxscp.backends import cuda, launch, libraries

HERE = Path(__file__).parent
COMPILER = shutil.which("g++")
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no g++ to compile the kernel for this machine")
needs_nvidia = pytest.mark.skipif(
    cuda.compiler() is None, reason="needs NVIDIA's run-time compiler (extra cuda)"
)


def compile_here(source, library, *options):
    """Compile a file into a shared library."""
    headers = [f"-I{libraries.HEADERS}", f"-I{HERE}"]
    flags = ["-std=c++20", "-O0", "-fPIC", "-w", "-shared", *options]
    subprocess.run([COMPILER, *flags, *headers, str(source), "-o", str(library)], check=True)


@functools.cache
def handler() -> str:
    """Name of the FFI target that runs a kernel on a CPU."""
    name = "jaxscp_test_kernel"
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "handler.so"
        compile_here(HERE / "kernel_handler_on_a_cpu.cc", library)
        assert libraries.register(ctypes.CDLL(str(library)), "jaxscp_run_kernel", target=name)
    return name


def compiled(
    text: str, folder: Path, keywords: str = "threads_on_a_cpu.h", headers=(), **macros: object
) -> bytes:
    """Path of a kernel's library, in place of a cubin; ``keywords`` is a header with CUDA's keywords."""
    source, library = folder / "kernel.cc", folder / "kernel.so"
    source.write_text(f'{text}\n#include "run_on_a_cpu.h"\n')
    options = [*(f"-I{h}" for h in headers), *(f"-D{name}={value}" for name, value in macros.items())]
    compile_here(source, library, "-include", keywords, *options)
    return str(library).encode()


def kernels_here(module, folder: Path, monkeypatch) -> None:
    """Let a ``native.gpu`` module run its kernels on this CPU, by threads that wait for each other."""

    def cubin(text, capability, owner, folders=(), **macros):
        own = folder / f"{len(list(folder.iterdir()))}"
        own.mkdir()
        return compiled(text, own, "warps_on_a_cpu.h", folders, **macros)

    monkeypatch.setattr(launch, "cubin", cubin)
    monkeypatch.setattr(module, "LIBRARY", module.LIBRARY._replace(on_gpu=handler()))
    monkeypatch.setattr(cuda, "capability", lambda: "90")
    monkeypatch.setattr(module, "supports", lambda *_, **__: False)  # tests expect the results of JAX and C++


def as_on_a_gpu(monkeypatch) -> None:
    """Trace as on a machine with a GPU, where every kernel compiles."""
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(cuda, "capability", lambda: "90")
    monkeypatch.setattr(cuda, "launches", lambda _: True)
    monkeypatch.setattr(cuda, "compiler", lambda: "one")
    monkeypatch.setattr(launch, "cubin", lambda *_, **__: b"a cubin")
