"""Files of NumPy: written whole or not at all, and the errors that NumPy raises for damaged ones."""

import contextlib
import os
import pathlib
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Iterator
from typing import BinaryIO

HEADER = "header"
"""Name of the array that only files of ``pytree_file`` have."""

DAMAGED = (
    ValueError,
    EOFError,
    KeyError,
    TypeError,
    OverflowError,
    NotImplementedError,
    SyntaxError,
    tokenize.TokenError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)
"""A damaged header is read as a Python literal: hence the errors of Python's own tokens and syntax."""


@contextlib.contextmanager
def replacing(file: str | os.PathLike) -> Iterator[BinaryIO]:
    """A stream whose content takes the file's place once all is written: a full disk leaves the old file as it was.

    Raises:
        OSError: if it cannot be written.
    """
    path = pathlib.Path(os.path.realpath(file))
    if path.exists() and not path.is_file():  # a device, a pipe, or a folder, which says so
        with open(path, "wb") as stream:
            yield stream
        return
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        with open(part, "wb") as stream:
            yield stream
        os.replace(part, path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def why_unreadable(file: str | os.PathLike, error: Exception) -> str:
    """Why a file is no archive, and what to do: NumPy's own advice for files of text is to unpickle them.

    Example:
        >>> why_unreadable("plan.npz", ValueError("This file contains pickled (object) data."))
        'it is no .npz'
    """
    if pathlib.Path(file).suffix.lower() in (".csv", ".txt"):
        return (
            "a table of samples cannot be loaded, as it lacks the mesh. Load the .npz that save wrote; or read the "
            "columns, and call jaxscp.Trajectory.from_arrays(times, states, controls)"
        )
    return "it is no .npz" if "pickle" in str(error) else str(error)
