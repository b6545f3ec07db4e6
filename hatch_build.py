"""Compiles the interior point's loop for CPUs, and what launches its kernel on GPUs, where there is a C++ compiler."""

import importlib.util
import os
import platform
import shutil
import subprocess
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

SOURCES = Path("jaxscp/conic/native")
X86 = {
    "v4": ("-march=x86-64-v4", "-mprefer-vector-width=512"),
    "v3": ("-march=x86-64-v3",),
}  # AVX-512; AVX2 and FMA
ELSEWHERE = {"any": ()}
FLAGS = ("-std=c++20", "-O3", "-fno-math-errno", "-fPIC", "-Wno-psabi")


class NativeBuild(BuildHookInterface):
    """One library for each level of the instruction set; which one runs is decided where the package is used."""

    def initialize(self, version: str, build_data: dict) -> None:
        """Compile into the source tree, from where both editable and ordinary installs take the libraries."""
        if self.target_name != "wheel":
            return
        compiler = shutil.which(os.environ.get("CXX", "")) or shutil.which("c++") or shutil.which("g++")
        if compiler is None:
            self.app.display_warning(
                "no C++ compiler: the interior point will run as compiled by XLA, slower"
            )
            return
        levels = X86 if platform.machine().lower() in ("x86_64", "amd64") else ELSEWHERE
        folder = Path(self.root) / SOURCES
        try:
            with ThreadPoolExecutor() as pool:
                libraries = list(
                    pool.map(lambda level: compile_library(compiler, folder, *level), levels.items())
                )
        except subprocess.CalledProcessError as error:
            self.app.display_warning(
                f"the interior point was not compiled, and will run slower:\n{error.stderr}"
            )
            return
        build_data["pure_python"] = False
        build_data["infer_tag"] = True
        build_data["artifacts"] += [str(library.relative_to(self.root)) for library in libraries]


def compile_library(compiler: str, folder: Path, level: str, machine: tuple[str, ...]) -> Path:
    """Build one level. What asks the processor for its instructions must not use them, so it is compiled for any."""
    headers = Path(importlib.util.find_spec("jaxlib").submodule_search_locations[0]) / "include"
    library = folder / f"interior_point_{level}.so"
    with tempfile.TemporaryDirectory() as scratch:
        number = level.removeprefix("v") if machine else "0"
        files = {"handler": machine, "gpu_handler": (), "runs_here": (f"-DJAXSCP_LEVEL={number}",)}
        objects = {name: Path(scratch) / f"{name}.o" for name in files}
        for name, flags in files.items():
            command = [*FLAGS, *flags, "-isystem", headers, "-c", folder / f"{name}.cc"]
            run(compiler, *command, "-o", objects[name])
        run(compiler, "-shared", *objects.values(), "-ldl", "-o", library)
    return library


def run(*command: str | Path) -> None:
    """Run a command; what it printed goes with the error."""
    subprocess.run([str(part) for part in command], check=True, capture_output=True, text=True)
