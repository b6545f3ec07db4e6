"""Build hook: compiles the C++ libraries, if there is a C++ compiler."""

import ctypes
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
from typing import NamedTuple

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

SHARED = Path("jaxscp/backends/native")
SOURCES = Path("jaxscp/backends/sources.py")
LIBRARIES = {  # stem: sources compiled for each instruction set, sources compiled once for any
    Path("jaxscp/conic/native/interior_point"): (("handler",), ("gpu_handler",)),
    Path("jaxscp/linalg/gram/native/gram"): (("handler",), ("gpu_handler",)),
    Path("jaxscp/linalg/riccati/native/riccati"): (("handler",), ("gpu_handler",)),
    Path("jaxscp/linalg/eigen/native/eigen"): (("handler",), ("gpu_handler",)),
    Path("jaxscp/integration/native/integration"): (("handler",), ("gpu_handler",)),
}
X86 = {
    "v4": ("-march=x86-64-v4", "-mprefer-vector-width=512"),
    "v3": ("-march=x86-64-v3",),
}  # v4: AVX-512; v3: AVX2 and FMA
ANYWHERE = {"any": ()}
FLAGS = ("-std=c++20", "-fno-math-errno", "-fPIC", "-Wno-psabi")
ALL = "JAXSCP_ALL_PROCESSORS"  # environment variable
FAST = "-O3"
SOON = "-O1"  # for code that only launches kernels: it compiles in two thirds of the time


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
        try:
            levels = levels_for(version, compiler, Path(self.root))
            libraries = compile_libraries(compiler, Path(self.root), levels)
        except subprocess.CalledProcessError as error:
            self.app.display_warning(
                f"the C++ libraries do not compile, and jaxscp will run slower:\n{error.stderr}"
            )
            return
        build_data["pure_python"] = False
        # no library refers to Python: one wheel serves every version
        build_data["tag"] = f"py3-none-{re.sub('[-.]', '_', sysconfig.get_platform())}"
        build_data["artifacts"] += [str(library.relative_to(self.root)) for library in libraries]


def levels_for(version: str, compiler: str, root: Path) -> dict[str, tuple[str, ...]]:
    """Instruction sets to compile for: each takes a third of a minute or more.

    An editable installation has them all, as tests need them. An ordinary one has those from AVX2 on that this machine
    runs, or else the one that runs anywhere. With ``JAXSCP_ALL_PROCESSORS=1`` it has them all, too.
    """
    if platform.machine().lower() not in ("x86_64", "amd64"):
        return ANYWHERE
    if version == "editable" or os.environ.get(ALL, "0") not in ("", "0"):
        return ANYWHERE | X86
    return {level: flags for level, flags in X86.items() if runs_here(compiler, root, level)} or ANYWHERE


def runs_here(compiler: str, root: Path, level: str) -> bool:
    """Whether this machine runs an instruction set, by the function that every library carries."""
    with tempfile.TemporaryDirectory() as scratch:
        unit, library = (
            about_itself(root, Path(scratch) / "runs_here.o", level, ""),
            Path(scratch) / "runs_here.so",
        )
        compile_unit(compiler, root, unit)
        run(compiler, "-shared", unit.output, "-o", library)
        return bool(ctypes.CDLL(str(library)).jaxscp_runs_here())


class Unit(NamedTuple):
    """A source, its object file and its compiler flags."""

    source: Path
    output: Path
    flags: tuple[str, ...]


def compile_libraries(compiler: str, root: Path, levels: dict[str, tuple[str, ...]]) -> list[Path]:
    """Files of all libraries for all instruction sets: sources are compiled side by side, then linked.

    One compiler a core, the longest source first: more of them at once take a fifth longer on two cores.

    Args:
        compiler: C++ compiler.
        root: folder of the project.
        levels: compiler flags of each instruction set, by its name.
    """
    files = []
    with tempfile.TemporaryDirectory() as scratch, ThreadPoolExecutor(os.cpu_count()) as pool:
        units = {}
        for stem in LIBRARIES:
            shared = units_of_any(root, stem, Path(scratch))
            for level, machine in levels.items():
                units[stem, level] = units_of_level(root, stem, Path(scratch), level, machine) + shared
        every = dict.fromkeys(unit for of_library in units.values() for unit in of_library)
        list(pool.map(lambda unit: compile_unit(compiler, root, unit), every))
        for (stem, level), of_library in units.items():
            files.append(root / stem.parent / f"{stem.name}_{level}.so")
            run(compiler, "-shared", *[unit.output for unit in of_library], "-ldl", "-o", files[-1])
    return files


def units_of_level(root: Path, stem: Path, scratch: Path, level: str, machine: tuple[str, ...]) -> list[Unit]:
    """Sources of a library that are compiled for each instruction set."""
    folder = root / stem.parent
    output = lambda name: scratch / f"{stem.name}_{name}_{level}.o"  # noqa: E731
    units = [Unit(folder / f"{name}.cc", output(name), (FAST, *machine)) for name in LIBRARIES[stem][0]]
    return [*units, about_itself(root, output("runs_here"), level, digest_of_sources(root)(folder))]


def about_itself(root: Path, output: Path, level: str, digest: str) -> Unit:
    """The source that tells of a library whether it runs here, and the digest of its sources.

    It asks the processor for its instructions, so it is compiled for any processor.
    """
    number = level.removeprefix("v") if level in X86 else "0"
    about = f"-DJAXSCP_LEVEL={number}", f'-DJAXSCP_SOURCES="{digest}"'
    return Unit(root / SHARED / "runs_here.cc", output, (SOON, *about))


def units_of_any(root: Path, stem: Path, scratch: Path) -> list[Unit]:
    """Sources of a library that are compiled once, for any processor."""
    folder = root / stem.parent
    return [
        Unit(folder / f"{name}.cc", scratch / f"{stem.name}_{name}.o", (SOON,)) for name in LIBRARIES[stem][1]
    ]


def compile_unit(compiler: str, root: Path, unit: Unit) -> None:
    """Make an object file."""
    run(compiler, *FLAGS, *unit.flags, f"-I{root / SHARED}", "-c", unit.source, "-o", unit.output)


def digest_of_sources(root: Path) -> Callable[[Path], str]:
    """The package's own function, loaded from its file: the package itself needs JAX, which a build does not have."""
    spec = importlib.util.spec_from_file_location("jaxscp_sources", root / SOURCES)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.digest


def run(*command: str | Path) -> None:
    """Run a command; an error carries the command's output."""
    subprocess.run([str(part) for part in command], check=True, capture_output=True, text=True)
