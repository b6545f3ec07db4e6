"""Errors that NumPy and its libraries raise for damaged .npy and .npz files."""

import os
import pathlib
import struct
import tokenize
import zipfile
import zlib

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
