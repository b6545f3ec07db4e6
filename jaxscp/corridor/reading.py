"""Point clouds from files. Formats are read by their own libraries; what is wrong is said with a place."""

import warnings
from collections.abc import Callable
from importlib import import_module
from os import PathLike
from pathlib import Path
from types import ModuleType

import numpy as np

from jaxscp.corridor.clouds import PointCloud

_SAMPLES_PER_CELL = 8
_MOST_SAMPLES = 20_000_000


class CloudFileError(ValueError):
    """A cloud file that cannot be read as what its name says; the message names the file and the place."""


def read_cloud(path: str | PathLike[str], *, spacing: float = 0.1, seed: int = 0) -> PointCloud:
    """Read a point cloud, or sample the surface of a mesh.

    =======================  ==================================================  ==============
    suffix                   what                                                read by
    =======================  ==================================================  ==============
    ``.pcd``                 Point Cloud Data: ascii, binary, binary_compressed  pypcd4
    ``.ply``                 the ``vertex`` element                              plyfile
    ``.xyz``, ``.txt``       x y z first in every line, blanks or commas         numpy
    ``.npy``                 an array (points, 3 or more)                        numpy
    ``.stl``, ``.obj``       a mesh, sampled at about ``spacing``                trimesh
    =======================  ==================================================  ==============

    The libraries come with ``pip install 'jaxscp[clouds]'``. Positions must be in metres.

    Args:
        path: the file.
        spacing: largest hole to leave in the samples of a mesh, metres.
        seed: of the samples of a mesh.

    Raises:
        FileNotFoundError: there is no such file.
        CloudFileError: the suffix is unknown, or the file is truncated or not what its suffix says.
        ImportError: the format's library is not installed.

    Example:
        >>> import pathlib, tempfile
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "two.xyz"
        >>> _ = path.write_text("0 0 1\\n2 0 1\\n")
        >>> read_cloud(path).count
        2
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no such file: {path}")
    suffix = path.suffix.lower()
    if suffix in (".stl", ".obj"):
        points = _read_mesh(path, spacing, seed)
    elif suffix in _READERS:
        points = _READERS[suffix](path)
    else:
        known = ", ".join([*_READERS, ".stl", ".obj"])
        raise CloudFileError(f"{path}: unknown kind of cloud file {suffix!r}; known are {known}")
    return PointCloud.of(points, source=str(path))


def _library(name: str, path: Path) -> ModuleType:
    try:
        return import_module(name)
    except ImportError as error:
        raise ImportError(f"reading {path.name} needs {name}: pip install 'jaxscp[clouds]'") from error


def _read_pcd(path: Path) -> np.ndarray:
    pypcd4 = _library("pypcd4", path)
    lines, start = _pcd_header(path)
    try:
        header = pypcd4.MetaData.parse_header(lines)
    except ValueError as error:
        raise CloudFileError(
            f"{path}: the header, lines 1 to {len(lines)}, is not that of a .pcd: {error}"
        ) from error
    missing = {"x", "y", "z"} - set(header.fields)
    if missing:
        raise CloudFileError(
            f"{path}: no field {', '.join(sorted(missing))} among FIELDS {' '.join(header.fields)}"
        )
    if header.data.value == "ascii":
        columns = [_pcd_column(header, name) for name in "xyz"]
        points = _read_table(path, columns, skip=len(lines))
        if points.shape[0] != header.points:
            raise CloudFileError(
                f"{path}: ends at line {len(lines) + points.shape[0]} with {points.shape[0]} points, "
                f"the header promises {header.points}"
            )
        return points
    _check_pcd_size(path, header, start)
    try:
        return pypcd4.PointCloud.from_path(str(path)).numpy(("x", "y", "z")).astype(float)
    except (ValueError, RuntimeError) as error:
        raise CloudFileError(f"{path}: the data from byte {start} on cannot be decoded: {error}") from error


def _pcd_header(path: Path) -> tuple[list[str], int]:
    """Lines up to and with DATA, and the byte at which the data begin."""
    lines: list[str] = []
    with path.open("rb") as file:
        for raw in file:
            line = raw[:200].decode("ascii", "replace").strip()
            lines.append(line)
            if line.startswith("DATA"):
                return lines, file.tell()
            if "\ufffd" in line or len(lines) > 100:
                break
    raise CloudFileError(f"{path}: line {max(len(lines), 1)}: not a .pcd header, no DATA line before it")


def _pcd_column(header, name: str) -> int:
    return int(sum(header.count[: header.fields.index(name)]))


def _check_pcd_size(path: Path, header, start: int) -> None:
    size = path.stat().st_size
    if header.data.value == "binary":
        needed = header.points * header.build_dtype().itemsize
    else:
        with path.open("rb") as file:
            file.seek(start)
            lengths = file.read(8)
        needed = 8 + (int.from_bytes(lengths[:4], "little") if len(lengths) == 8 else 0)
    if header.points and size - start < needed:
        raise CloudFileError(
            f"{path}: truncated at byte {size}: the header promises {header.points} points, "
            f"which end at byte {start + needed}"
        )


def _read_ply(path: Path) -> np.ndarray:
    plyfile = _library("plyfile", path)
    try:
        vertex = plyfile.PlyData.read(str(path))["vertex"]
        return np.stack([np.asarray(vertex[axis], float) for axis in "xyz"], axis=1)
    except plyfile.PlyParseError as error:
        raise CloudFileError(f"{path}: {error} (file of {path.stat().st_size} bytes)") from error
    except (KeyError, ValueError) as error:
        raise CloudFileError(f"{path}: no element 'vertex' with x, y and z: {error}") from error
    except UnicodeDecodeError as error:
        raise CloudFileError(f"{path}: byte {error.start}: not a .ply header") from error


def _read_xyz(path: Path) -> np.ndarray:
    return _read_table(path, [0, 1, 2], skip=0)


def _read_table(path: Path, columns: list[int], skip: int) -> np.ndarray:
    """Numbers from a text file with blanks or commas between them and # before comments."""
    try:
        with path.open(encoding="utf-8") as file:
            lines = (line.replace(",", " ") for line in file)
            for _ in range(skip):
                next(lines, None)
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", message=".*input contained no data", category=UserWarning)
                return np.loadtxt(lines, usecols=columns, ndmin=2).reshape(-1, 3)
    except UnicodeDecodeError as error:
        raise CloudFileError(f"{path}: byte {error.start} of a block is not text") from error
    except (ValueError, IndexError) as error:
        raise CloudFileError(_first_bad_line(path, columns, skip) or f"{path}: {error}") from error


def _first_bad_line(path: Path, columns: list[int], skip: int) -> str | None:
    with path.open(encoding="utf-8", errors="replace") as file:
        for number, line in enumerate(file, start=1):
            words = line.split("#")[0].replace(",", " ").split()
            if number <= skip or not words:
                continue
            try:
                [float(words[column]) for column in columns]
            except (ValueError, IndexError):
                return f"{path}: line {number}: expected x y z, got {line.strip()[:60]!r}"
    return None


def _read_npy(path: Path) -> np.ndarray:
    try:
        array = np.load(path, allow_pickle=False)
    except (ValueError, EOFError, OSError) as error:
        raise CloudFileError(
            f"{path}: not a whole .npy file of {path.stat().st_size} bytes: {error}"
        ) from error
    if array.ndim != 2 or array.shape[1] < 3 or not np.issubdtype(array.dtype, np.number):
        raise CloudFileError(
            f"{path}: expected numbers of shape (points, 3), got {array.dtype} {array.shape}"
        )
    return array[:, :3].astype(float)


def _read_mesh(path: Path, spacing: float, seed: int) -> np.ndarray:
    """Random samples, eight for each square of side ``spacing``, so that holes wider than it are unlikely."""
    if not spacing > 0:
        raise ValueError(f"spacing must be positive, got {spacing} m")
    trimesh = _library("trimesh", path)
    try:
        mesh = trimesh.load_mesh(str(path))
    except Exception as error:  # its loaders raise whatever their parsers raise
        raise CloudFileError(f"{path}: not a mesh of {path.stat().st_size} bytes: {error}") from error
    faces = np.asarray(getattr(mesh, "faces", ()))
    if faces.size == 0 or not np.isfinite(mesh.vertices).all():
        raise CloudFileError(f"{path}: no triangle with finite corners in its {path.stat().st_size} bytes")
    samples = int(np.ceil(_SAMPLES_PER_CELL * mesh.area / spacing**2))
    if samples > _MOST_SAMPLES:
        raise CloudFileError(
            f"{path}: a surface of {mesh.area:.0f} m^2 needs {samples} samples at a spacing of {spacing} m. "
            "Is the mesh in metres? Else choose a larger spacing."
        )
    points, _ = trimesh.sample.sample_surface(mesh, samples, seed=seed)
    return np.concatenate([np.asarray(points), mesh.vertices])


_READERS: dict[str, Callable[[Path], np.ndarray]] = {
    ".pcd": _read_pcd,
    ".ply": _read_ply,
    ".xyz": _read_xyz,
    ".txt": _read_xyz,
    ".npy": _read_npy,
}
