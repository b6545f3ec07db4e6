"""Files of laser scanners: .las and .laz, read by laspy, and .e57, read by pye57."""

from pathlib import Path

import numpy as np

from jaxscp.corridor.file_content import CloudFileError, FileContent, Request

_NOISE = (7, 18)


def read_las(path: Path, request: Request) -> FileContent:
    """Points of a .las or .laz; those classified as noise (7 and 18) are left out.

    Raises:
        CloudFileError: the file is truncated or no .las.
    """
    try:
        scan = request.library.read(str(path))
        points, classes = np.asarray(scan.xyz, float), np.asarray(scan.classification)
    except Exception as error:  # laspy, its decompressor and struct each raise their own
        raise CloudFileError(f"{path}: not a whole .las of {path.stat().st_size} bytes: {error}") from error
    noise = np.isin(classes, _NOISE)
    count = int(noise.sum())
    notes = (f"{count} points are classified as noise and left out",) if count else ()
    return FileContent(points[~noise] if count else points, notes=notes)


def read_e57(path: Path, request: Request) -> FileContent:
    """Points of every scan of an .e57, in its common frame; its unit is the metre by its standard.

    Raises:
        CloudFileError: the file is truncated or no .e57.
    """
    try:
        file = request.library.E57(str(path))
        try:
            scans = [file.read_scan(k, ignore_missing_fields=True) for k in range(file.scan_count)]
        finally:
            file.close()
        parts = [np.stack([scan[f"cartesian{axis}"] for axis in "XYZ"], axis=1) for scan in scans]
    except Exception as error:  # pye57 raises those of a C++ library
        raise CloudFileError(f"{path}: not a whole .e57 of {path.stat().st_size} bytes: {error}") from error
    points = np.concatenate(parts) if parts else np.empty((0, 3))
    return FileContent(points, unit="m", frame="enu")
