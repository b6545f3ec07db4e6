"""A commit's package with its C++ libraries in a folder of its own, and processes that import it from there."""

import ctypes
import json
import os
import platform
import shutil
import subprocess
import sys
import tarfile
import tempfile
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).parents[2]
WORKER = Path(__file__).with_name("worker.py")
WORKING_TREE = "working tree"
LEVELS = ("v4", "v3", "any")  # best first; a library's file is stem_level.so
NO_LIBRARY = "none"  # JAX alone


class Side(NamedTuple):
    """One of the two that are compared."""

    name: str
    """The commit's id, or ``WORKING_TREE``."""
    package: Path
    """Folder that jaxscp is imported from."""
    scratch: Path
    """For files of its workers."""

    def levels(self) -> list[str]:
        """Instruction sets whose libraries were compiled and run here, best first; JAX alone comes last."""
        found = [
            level for level in LEVELS if (files := self.libraries(level)) and all(map(_runs_here, files))
        ]
        return [*found, NO_LIBRARY]

    def libraries(self, level: str) -> list[Path]:
        """Files for one instruction set."""
        return sorted(self.package.glob(f"jaxscp/**/*_{level}.so"))

    def at_level(self, level: str) -> "Side":
        """A copy of the package that has the libraries of one level alone: no code of the package need be patched."""
        package = self.scratch / f"package_{level}"
        if not package.exists():
            others = [f"*_{other}.so" for other in LEVELS if other != level]
            shutil.copytree(self.package, package, ignore=shutil.ignore_patterns(*others))
        return self._replace(package=package)

    def run(self, task: str, **arguments: Any) -> Any:
        """What a task of the worker answers, in a fresh process."""
        process = subprocess.run(
            self.command(task, arguments),
            env=self.environment(),
            cwd=self.scratch,
            capture_output=True,
            text=True,
        )
        if process.returncode != 0:
            raise RuntimeError(f"{self.name}: {task} ended with {process.returncode}:\n{process.stderr}")
        return json.loads(process.stdout.splitlines()[-1])

    def command(self, task: str, arguments: dict[str, Any]) -> list[str]:
        """Command line of a worker."""
        return [sys.executable, "-P", str(WORKER), str(self.package), task, json.dumps(arguments)]

    def environment(self) -> dict[str, str]:
        """Environment of a worker: this package comes first, and JAX finds no cache."""
        left_out = ("JAX_COMPILATION_CACHE_DIR", "PYTHONPATH")
        variables = {name: value for name, value in os.environ.items() if name not in left_out}
        return {"JAX_PLATFORMS": "cpu"} | variables | {"PYTHONPATH": str(self.package)}

    def export(self) -> str:
        """File of an exported planner; written once."""
        file = self.scratch / "planner.jaxscp"
        if not file.exists():
            self.run("export", file=str(file))
        return str(file)


def build_both(old: str, new: str, scratch: Path, builds: Path | None) -> tuple[Side, Side]:
    """Both packages. One is built after the other: each takes all cores.

    Args:
        old: a commit, by any name that git knows.
        new: another, or ``WORKING_TREE``.
        scratch: folder for what is temporary.
        builds: folder where packages of commits stay for later runs; None for none.
    """
    names = [name if name == WORKING_TREE else _git("rev-parse", f"{name}^{{commit}}") for name in (old, new)]
    folders = scratch / "old", scratch / "new"
    packages = [folder / "package" for folder in folders]
    if builds is not None:
        stays = builds.absolute() / f"jaxlib{version('jaxlib')}-python{platform.python_version()}"
        packages = [
            package if name == WORKING_TREE else stays / name
            for name, package in zip(names, packages, strict=True)
        ]
    for name, package, folder in zip(names, packages, folders, strict=True):
        folder.mkdir()
        if not package.exists():
            with tempfile.TemporaryDirectory(dir=folder) as source:
                _check_out(name, Path(source))
                _install(Path(source), package)
    first, second = (Side(*parts) for parts in zip(names, packages, folders, strict=True))
    return first, second


def in_parallel(function: Any, *sides: Side) -> list[Any]:
    """The function of both sides, each in a thread."""
    with ThreadPoolExecutor() as threads:
        return list(threads.map(function, sides))


def _check_out(name: str, source: Path) -> None:
    """The files that git knows; of the working tree, those too that it does not ignore."""
    if name != WORKING_TREE:
        archive = source.with_suffix(".tar")
        _git("archive", "--format=tar", f"--output={archive}", name)
        with tarfile.open(archive) as tar:
            if hasattr(tarfile, "data_filter"):  # from Python 3.11.4 on
                tar.extractall(source, filter="data")
            else:
                tar.extractall(source)
        archive.unlink()
        return
    for file in _git("ls-files", "-z", "--cached", "--others", "--exclude-standard").split("\0"):
        if (ROOT / file).is_file():
            (source / file).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / file, source / file)


def _install(source: Path, package: Path) -> None:
    """By pip, which compiles the libraries; under another name first, so that no folder is half a package."""
    unfinished = package.with_name(f"{package.name}.unfinished")
    shutil.rmtree(unfinished, ignore_errors=True)
    options = ("--quiet", "--no-deps", "--no-build-isolation", "--disable-pip-version-check")
    command = [sys.executable, "-m", "pip", "install", *options, "--target", str(unfinished), str(source)]
    process = subprocess.run(command, capture_output=True, text=True)
    if process.returncode != 0:
        raise RuntimeError(f"pip failed (it needs hatchling in this environment):\n{process.stderr}")
    unfinished.rename(package)


def _runs_here(library: Path) -> bool:
    return bool(ctypes.CDLL(str(library)).jaxscp_runs_here())


def _git(*arguments: str) -> str:
    return subprocess.run(
        ["git", *arguments], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout.strip()
