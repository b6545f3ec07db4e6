"""Meshes in text: .obj and .off. Vertices of no face are points, and a file of vertices alone is a cloud."""

import re
from array import array
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from jaxscp.corridor.file_content import CloudFileError, FileContent, Request
from jaxscp.corridor.surfaces import Surface, fans, surface_content

_OFF = re.compile(r"^(ST)?C?N?OFF\b", re.IGNORECASE)


class _Rows:
    """Lists of vertex numbers, one after the other."""

    def __init__(self) -> None:
        self.flat, self.sizes = array("q"), array("q")

    def append(self, numbers: list[int]) -> None:
        if numbers:
            self.flat.extend(numbers)
            self.sizes.append(len(numbers))

    def arrays(self) -> tuple[np.ndarray, np.ndarray]:
        return np.array(self.flat, int), np.array(self.sizes, int)


def read_obj(path: Path, request: Request) -> FileContent:
    """Samples of the faces and lines of a .obj, and its other vertices.

    Raises:
        CloudFileError: a line is damaged, or an element names a vertex that does not exist.
    """
    vertices, faces, lines = array("d"), _Rows(), _Rows()
    for number, line in _obj_lines(path):
        key, _, rest = line.partition(" ")
        try:
            if key == "v":
                words = rest.split()
                vertices.extend((float(words[0]), float(words[1]), float(words[2])))
            elif key == "f":
                faces.append(_vertex_numbers(rest, len(vertices) // 3))
            elif key == "l":
                lines.append(_vertex_numbers(rest, len(vertices) // 3))
        except IndexError as error:
            raise CloudFileError(f"{path}: line {number}: a vertex needs x y z, got {line[:60]!r}") from error
        except ValueError as error:
            raise CloudFileError(f"{path}: line {number}: {error}, in {line[:60]!r}") from error
    if not vertices:
        raise CloudFileError(f"{path}: no line of it is a vertex, 'v x y z'; is it another kind of file?")
    triangles, (flat, sizes) = fans(*faces.arrays()), lines.arrays()
    joined = np.ones(max(len(flat) - 1, 0), bool)
    joined[(np.cumsum(sizes) - 1)[:-1]] = False
    segments = np.column_stack([flat[:-1], flat[1:]])[joined]
    corners = np.array(vertices, float).reshape(-1, 3)
    return surface_content(path, Surface(corners, triangles, segments, first=1), request)


def _obj_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Lines with their numbers; one that ends in a backslash goes on in the next."""
    held = ""
    # Comments and names in Latin-1 do not matter to a mesh.
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        for number, raw in enumerate(file, start=1):
            line = held + raw.strip().replace("\t", " ")
            held = line[:-1] + " " if line.endswith("\\") else ""
            if not held:
                yield number, line
    if held:
        yield number, held.strip()


def _vertex_numbers(text: str, count: int) -> list[int]:
    """Vertex numbers from 0 of a face or line; a negative number counts from the last vertex before it."""
    words = text.split("#")[0].split()
    numbers = [int(word) for word in ([word.partition("/")[0] for word in words] if "/" in text else words)]
    if numbers and min(numbers) > 0:
        return [number - 1 for number in numbers]
    wrong = next((number for number in numbers if number == 0 or number < -count), None)
    if wrong is not None:
        raise ValueError(f"vertex {wrong} does not exist, with {count} before it")
    return [number - 1 if number > 0 else count + number for number in numbers]


def read_off(path: Path, request: Request) -> FileContent:
    """Samples of the faces of a .off, and its other vertices.

    Raises:
        CloudFileError: a line is damaged, or the header counts other numbers of vertices and faces.
    """
    text = path.read_text(encoding="utf-8-sig", errors="replace")
    lines = [line for raw in text.splitlines() if (line := raw.split("#")[0].strip())]
    found = _OFF.match(lines[0]) if lines else None
    if found is None:
        raise CloudFileError(f"{path}: does not begin with OFF; is it another kind of file?")
    rows = [line.split() for line in [lines[0][found.end() :], *lines[1:]] if line]
    try:
        vertices, faces = (int(word) for word in rows[0][:2])
    except (ValueError, IndexError) as error:
        raise CloudFileError(
            f"{path}: no counts of vertices and faces after OFF (text is read, not binary)"
        ) from error
    if len(rows) - 1 != vertices + faces:
        raise CloudFileError(
            f"{path}: the header counts {vertices} vertices and {faces} faces, but {len(rows) - 1} rows follow: cut "
            "off, or a wrong count"
        )
    try:
        corners = np.array([row[:3] for row in rows[1 : vertices + 1]], float).reshape(vertices, 3)
        lists = _Rows()
        for row in rows[vertices + 1 :]:
            numbers = [int(word) for word in row[1 : int(row[0]) + 1]]
            if len(numbers) != int(row[0]):
                raise ValueError(f"a face of {row[0]} corners names {len(numbers)}")
            lists.append(numbers)
    except ValueError as error:
        raise CloudFileError(f"{path}: damaged: {error}") from error
    return surface_content(path, Surface(corners, fans(*lists.arrays())), request)
