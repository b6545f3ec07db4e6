"""A C++ compiler that compiles nothing twice: objects stay in a folder, by a hash of their preprocessed source.

    python -P compiler.py COMPILER FOLDER ARGUMENTS...

Most commits leave the C++ as it was, or move its files, and to compile it takes minutes.
"""

import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path


def main(compiler: str, folder: str, *arguments: str) -> int:
    """Compile or link as the arguments say; the exit code."""
    if "-c" not in arguments:
        return subprocess.call([compiler, *arguments])
    output = Path(arguments[arguments.index("-o") + 1])
    stored = Path(folder) / f"{_key(compiler, arguments)}.o"
    if not stored.exists():
        code = subprocess.call([compiler, *arguments])
        if code != 0:
            return code
        unfinished = stored.with_suffix(f".{os.getpid()}")
        shutil.copyfile(output, unfinished)
        unfinished.rename(stored)
    shutil.copyfile(stored, output)
    return 0


def _key(compiler: str, arguments: tuple[str, ...]) -> str:
    """Of the compiler, its options but for names of files, and the source without line numbers."""
    source, output = arguments.index("-c") + 1, arguments.index("-o") + 1
    options = [a for k, a in enumerate(arguments) if k not in (source - 1, source, output - 1, output)]
    command = [compiler, *options, "-E", "-P", arguments[source]]
    text = subprocess.run(command, check=True, capture_output=True).stdout
    version = subprocess.run([compiler, "--version"], check=True, capture_output=True).stdout
    flags = "\0".join(a for a in options if not a.startswith("-I")).encode()
    return hashlib.sha256(b"\0".join((version, flags, text))).hexdigest()


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
