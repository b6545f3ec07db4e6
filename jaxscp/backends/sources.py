"""Digest of C++ sources. It tells whether a compiled library is older than its sources.

The build hook loads this file by its path: it imports the standard library only.
"""

import hashlib
from pathlib import Path

SHARED = Path(__file__).parent / "native"
"""Folder of the sources that all libraries share."""


def digest(folder: Path, shared: Path = SHARED) -> str:
    """Hexadecimal digest of the C++ sources of a library: names and contents of its own and the shared files.

    Args:
        folder: folder of the library's own sources.
        shared: folder of the shared sources.
    """
    result = hashlib.sha256()
    for file in (*sorted(shared.iterdir()), *sorted(folder.iterdir())):
        if file.suffix in (".h", ".cc"):
            content = file.read_bytes()
            result.update(f"{file.name} {len(content)} ".encode() + content)
    return result.hexdigest()
