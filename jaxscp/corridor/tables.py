"""Text tables of points: headers, separators, comments, encodings, and columns by name."""

import codecs
import re
import warnings
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxscp.corridor.columns import chosen_columns, has_names, named_columns
from jaxscp.corridor.file_content import CloudFileError, FileContent, Request

_SAMPLE = 2000
_COMMENT = re.compile(r"^\s*(#|//|%)")
_DECIMAL_COMMA = re.compile(r"^[+-]?\d+,\d+(e[+-]?\d+)?$", re.IGNORECASE)


class Dialect(NamedTuple):
    """How to read the lines of one text table."""

    encoding: str
    separator: str | None
    """None stands for blanks and tabs."""
    decimal_comma: bool
    skip: int
    """Lines before the first row of numbers."""
    header: list[str] | None
    """Names of the columns."""
    count: int | None = None
    """Number of points that a line before the rows states, as .pts files have it."""

    def words(self, line: str) -> list[str]:
        """Fields of one line; a comment at its end is left out."""
        line = line.split("#")[0].strip()
        if self.decimal_comma:
            line = line.replace(",", ".")
        return [word.strip() for word in line.split(self.separator)] if line else []


def read_table(path: Path, request: Request) -> FileContent:
    """Points from a text table; x, y and z are found by the header, or are the first three columns.

    Raises:
        CloudFileError: a line holds no three numbers, a column counts and is no coordinate, or the number of points
            before the rows is not theirs.
    """
    dialect = sniff(path)
    rows = _sample(path, dialect)
    if dialect.header is not None:
        unit, frame, columns = named_columns(path, dialect.header, request.layout)
        notes = ()
    else:
        unit = frame = None
        columns, notes = chosen_columns(str(path), rows, request.layout)
    points = read_columns(path, columns, dialect)
    if dialect.count is not None and dialect.count != len(points):
        cause = "cut off" if len(points) < dialect.count else "rows were added"
        raise CloudFileError(
            f"{path}: its first line states {dialect.count} points, but {len(points)} rows follow: {cause}?"
        )
    return FileContent(points, unit, frame, notes=notes)


def sniff(path: Path) -> Dialect:
    """Encoding, separator, decimal sign and header of a text table.

    Raises:
        CloudFileError: the file is not text.
    """
    encoding = _encoding(path)
    header: list[str] | None = None
    count: int | None = None
    with path.open(encoding=encoding) as file:
        for number, raw in enumerate(file):
            line = raw.strip()
            comment = _COMMENT.match(line)
            text = line[comment.end() :].strip() if comment else line
            words = [word for word in re.split(r"[,;\s]+", text) if word]
            if not words:
                continue
            if len(words) == 1 and words[0].isdecimal() and not comment:
                count = int(words[0])
            elif comment:
                names = _split_names(text)
                header = names if has_names(names) else header
            elif _is_number(words[0]):
                return Dialect(encoding, *_separator(line), number, header, count)
            elif header is None and len(words) >= 3:
                header = _split_names(text)
            else:
                break  # a bad line, which is named when it is read
    return Dialect(encoding, None, False, 0, None)


def read_columns(path: Path, columns: list[int], dialect: Dialect) -> np.ndarray:
    """Three columns of numbers.

    Raises:
        CloudFileError: a line lacks one of them; the message has its number.
    """
    plain = not dialect.decimal_comma and dialect.separator in (None, ",", ";", "\t")
    try:
        with path.open(encoding=dialect.encoding) as file, warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*input contained no data", category=UserWarning)
            for _ in range(dialect.skip):
                next(file, None)
            lines = file if plain else (" ".join(dialect.words(line)) for line in file)
            separator = dialect.separator if plain else None
            return np.loadtxt(lines, usecols=columns, ndmin=2, delimiter=separator).reshape(-1, 3)
    except UnicodeDecodeError as error:
        raise CloudFileError(f"{path}: byte {error.start} of a block is not text") from error
    except (ValueError, IndexError) as error:
        raise CloudFileError(_first_bad_line(path, columns, dialect) or f"{path}: {error}") from error


def _encoding(path: Path) -> str:
    """UTF-8, UTF-16 by its mark, or Latin-1, which has a letter for every byte."""
    with path.open("rb") as file:
        head = file.read(1 << 16)
        if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
            return "utf-16"
        control = re.search(rb"[\x00-\x08\x0e-\x1f]", head)
        if control:
            raise CloudFileError(f"{path}: byte {control.start()} is not text; is it another kind of file?")
        file.seek(0)
        decoder = codecs.getincrementaldecoder("utf-8")()
        try:
            for block in iter(lambda: file.read(1 << 22), b""):
                decoder.decode(block)
            decoder.decode(b"", final=True)
        except UnicodeDecodeError:
            return "latin-1"
    return "utf-8-sig"


def _separator(line: str) -> tuple[str | None, bool]:
    """Separator of the first row, and whether its numbers have a decimal comma."""
    words = line.split()
    if ";" in line:
        return ";", any(_DECIMAL_COMMA.match(word.strip()) for word in line.split(";"))
    if "," not in line:
        return ("\t", False) if "\t" in line and len(line.split("\t")) >= 3 else (None, False)
    if len(words) >= 3 and all(_DECIMAL_COMMA.match(word) or _is_number(word) for word in words):
        return None, True
    return (
        (",", False)
        if len(line.split(",")) >= 3 and not re.search(r"[^,\s]\s+[^,\s]", line)
        else (" ,", False)
    )


def _split_names(header: str) -> list[str]:
    separator = next((sign for sign in ";,\t" if sign in header), None)
    return [name.strip().strip("\"'") for name in header.split(separator)]


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _sample(path: Path, dialect: Dialect) -> np.ndarray:
    """The first rows of numbers, all columns; empty where they are not alike."""
    with path.open(encoding=dialect.encoding) as file:
        rows = [dialect.words(line) for line in islice(file, dialect.skip, dialect.skip + _SAMPLE)]
    rows = [row for row in rows if row]
    width = min((len(row) for row in rows), default=0)
    try:
        return np.array([row[:width] for row in rows], float).reshape(len(rows), width)
    except ValueError:
        return np.empty((0, width))


def _lines(path: Path, dialect: Dialect) -> Iterator[tuple[int, str]]:
    with path.open(encoding=dialect.encoding, errors="replace") as file:
        yield from islice(enumerate(file, start=1), dialect.skip, None)


def _first_bad_line(path: Path, columns: list[int], dialect: Dialect) -> str | None:
    for number, line in _lines(path, dialect):
        words = dialect.words(line)
        try:
            [float(words[column]) for column in columns] if words else None
        except (ValueError, IndexError):
            return f"{path}: line {number}: expected x y z, got {line.strip()[:60]!r}"
    return None
