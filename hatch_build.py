"""Build hook: compiles the C++ libraries, if there is a C++ compiler."""

import importlib.util
import os
import platform
import re
import shutil
import subprocess
import sysconfig
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

SHARED = Path("jaxscp/backends/native")
SOURCES = Path("jaxscp/backends/sources.py")
LIBRARIES = {  # stem: sources compiled for each instruction set, sources compiled for any
    Path("jaxscp/conic/native/interior_point"): (("handler",), ("gpu_handler",)),
    Path("jaxscp/linalg/gram/native/gram"): (("handler",), ()),
    Path("jaxscp/linalg/riccati/native/riccati"): (("handler",), ("gpu_handler",)),
    Path("jaxscp/linalg/eigen/native/eigen"): (("handler",), ()),
    Path("jaxscp/integration/native/integration"): (("handler",), ("gpu_handler",)),
}
X86 = {
    "v4": ("-march=x86-64-v4", "-mprefer-vector-width=512"),
    "v3": ("-march=x86-64-v3",),
}  # v4: AVX-512; v3: AVX2 and FMA
ANYWHERE = {"any": ()}
FLAGS = ("-std=c++20", "-O3", "-fno-math-errno", "-fPIC", "-Wno-psabi")


class NativeBuild(BuildHookInterface):
    """One file for each library and instruction set; the package loads the best one that runs."""

    def initialize(self, version: str, build_data: dict) -> None:
        """Compile into the source tree, from where both editable and ordinary installs take the files."""
        if self.target_name != "wheel":
            return
        compiler = shutil.which(os.environ.get("CXX", "")) or shutil.which("c++") or shutil.which("g++")
        if compiler is None:
            self.app.display_warning("no C++ compiler: jaxscp will run without its C++ libraries, slower")
            return
        levels = ANYWHERE | (X86 if platform.machine().lower() in ("x86_64", "amd64") else {})
        builds = [(stem, *level) for stem in LIBRARIES for level in levels.items()]
        try:
            with ThreadPoolExecutor() as pool:
                libraries = list(
                    pool.map(lambda each: compile_library(compiler, Path(self.root), *each), builds)
                )
        except subprocess.CalledProcessError as error:
            self.app.display_warning(
                f"the C++ libraries do not compile, and jaxscp will run slower:\n{error.stderr}"
            )
            return
        build_data["pure_python"] = False
        # no library refers to Python: one wheel serves every version
        build_data["tag"] = f"py3-none-{re.sub('[-.]', '_', sysconfig.get_platform())}"
        build_data["artifacts"] += [str(library.relative_to(self.root)) for library in libraries]


def compile_library(compiler: str, root: Path, stem: Path, level: str, machine: tuple[str, ...]) -> Path:
    """File of a library for one instruction set.

    ``runs_here.cc`` asks the processor for its instructions, so it is compiled for any processor. It also carries the
    digest of the sources.

    Args:
        compiler: C++ compiler.
        root: folder of the project.
        stem: key of ``LIBRARIES``.
        level: name of the instruction set.
        machine: compiler flags of the instruction set.
    """
    headers = Path(importlib.util.find_spec("jaxlib").submodule_search_locations[0]) / "include"
    folder = (root / stem).parent
    of_level, of_any = LIBRARIES[stem]
    number = level.removeprefix("v") if machine else "0"
    sources = {folder / f"{name}.cc": machine for name in of_level}
    sources |= {folder / f"{name}.cc": () for name in of_any}
    digest = digest_of_sources(root)(folder)
    sources[root / SHARED / "runs_here.cc"] = (f"-DJAXSCP_LEVEL={number}", f'-DJAXSCP_SOURCES="{digest}"')
    library = folder / f"{stem.name}_{level}.so"
    with tempfile.TemporaryDirectory() as scratch:
        objects = [Path(scratch) / f"{source.stem}.o" for source in sources]
        for output, (source, flags) in zip(objects, sources.items(), strict=True):
            run(
                compiler,
                *FLAGS,
                *flags,
                f"-I{root / SHARED}",
                "-isystem",
                headers,
                "-c",
                source,
                "-o",
                output,
            )
        run(compiler, "-shared", *objects, "-ldl", "-o", library)
    return library


def digest_of_sources(root: Path) -> Callable[[Path], str]:
    """The package's own function, loaded from its file: the package itself needs JAX, which a build does not have."""
    spec = importlib.util.spec_from_file_location("jaxscp_sources", root / SOURCES)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.digest


def run(*command: str | Path) -> None:
    """Run a command; an error carries the command's output."""
    subprocess.run([str(part) for part in command], check=True, capture_output=True, text=True)
