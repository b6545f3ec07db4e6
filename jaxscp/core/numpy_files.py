"""Errors that NumPy and its libraries raise for damaged .npy and .npz files."""

import struct
import tokenize
import zipfile
import zlib

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
