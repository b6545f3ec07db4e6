"""Build hook: compiles the C++ libraries if a C++ compiler is present."""

import importlib.util
import os
import platform
import shutil
import subprocess
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

SHARED = Path("jaxscp/backends/native")
LIBRARIES = {  # sources compiled once for each instruction level, and sources compiled for any processor
    Path("jaxscp/conic/native/interior_point"): (("handler",), ("gpu_handler",)),
    Path("jaxscp/linalg/gram/native/normal"): (("handler",), ()),
    Path("jaxscp/linalg/riccati/native/riccati"): (("handler",), ()),
    Path("jaxscp/linalg/eigen/native/semidefinite"): (("handler",), ()),
    Path("jaxscp/integration/native/sweep"): (("handler",), ("gpu_handler",)),
}
X86 = {
    "v4": ("-march=x86-64-v4", "-mprefer-vector-width=512"),
    "v3": ("-march=x86-64-v3",),
}  # v4: AVX-512; v3: AVX2 and FMA
ANYWHERE = {"any": ()}
FLAGS = ("-std=c++20", "-O3", "-fno-math-errno", "-fPIC", "-Wno-psabi")


class NativeBuild(BuildHookInterface):
    """One library for each instruction level; the package chooses a level when it is used."""

    def initialize(self, version: str, build_data: dict) -> None:
        """Compile into the source tree: editable and ordinary installs both take the libraries from there."""
        if self.target_name != "wheel":
            return
        compiler = shutil.which(os.environ.get("CXX", "")) or shutil.which("c++") or shutil.which("g++")
        if compiler is None:
            self.app.display_warning("no C++ compiler: all will run as compiled by XLA, slower")
            return
        levels = ANYWHERE | (X86 if platform.machine().lower() in ("x86_64", "amd64") else {})
        wanted = [(stem, *level) for stem in LIBRARIES for level in levels.items()]
        try:
            with ThreadPoolExecutor() as pool:
                libraries = list(
                    pool.map(lambda each: compile_library(compiler, Path(self.root), *each), wanted)
                )
        except subprocess.CalledProcessError as error:
            self.app.display_warning(f"what is in C++ was not compiled, and will run slower:\n{error.stderr}")
            return
        build_data["pure_python"] = False
        build_data["infer_tag"] = True
        build_data["artifacts"] += [str(library.relative_to(self.root)) for library in libraries]


def compile_library(compiler: str, root: Path, stem: Path, level: str, machine: tuple[str, ...]) -> Path:
    """Build one level; returns the library.

    ``runs_here.cc`` asks the processor for its instructions and must not use them: it is compiled for any processor.
    """
    headers = Path(importlib.util.find_spec("jaxlib").submodule_search_locations[0]) / "include"
    folder = (root / stem).parent
    of_level, of_any = LIBRARIES[stem]
    number = level.removeprefix("v") if machine else "0"
    sources = {folder / f"{name}.cc": machine for name in of_level}
    sources |= {folder / f"{name}.cc": () for name in of_any}
    sources[root / SHARED / "runs_here.cc"] = (f"-DJAXSCP_LEVEL={number}",)
    library = folder / f"{stem.name}_{level}.so"
    with tempfile.TemporaryDirectory() as scratch:
        objects = [Path(scratch) / f"{source.stem}.o" for source in sources]
        for made, (source, flags) in zip(objects, sources.items(), strict=True):
            run(compiler, *FLAGS, *flags, f"-I{root / SHARED}", "-isystem", headers, "-c", source, "-o", made)
        run(compiler, "-shared", *objects, "-ldl", "-o", library)
    return library


def run(*command: str | Path) -> None:
    """Run a command; an error carries the command's output."""
    subprocess.run([str(part) for part in command], check=True, capture_output=True, text=True)
