"""Files of laser scanners: .las and .laz, read by laspy, and .e57, read by pye57."""

from pathlib import Path
from typing import Any

import numpy as np

from jaxscp.corridor.file_content import CloudFileError, FileContent, Request

_NOISE = (7, 18)


def read_las(path: Path, request: Request) -> FileContent:
    """Points of a .las or .laz; those classified as noise (7 and 18) are left out.

    Raises:
        CloudFileError: the file is truncated or no .las, or the header states another number of points.
    """
    laspy = request.library
    try:
        with laspy.open(str(path)) as file:
            stated, held = file.header.point_count, _records(path, file.header)
            scan = file.read() if held in (None, stated) else None
    except Exception as error:  # laspy, its decompressor and struct each raise their own
        raise CloudFileError(f"{path}: not a whole .las of {path.stat().st_size} bytes: {error}") from error
    read = held if scan is None else len(scan.points)
    if scan is None or read != stated:
        cause = "cut off" if read is not None and read < stated else "the header was not brought up to date"
        raise CloudFileError(f"{path}: the header states {stated} points, but the file holds {read}: {cause}")
    points, classes = np.asarray(scan.xyz, float), np.asarray(scan.classification)
    noise = np.isin(classes, _NOISE)
    count = int(noise.sum())
    notes = (f"{count} points are classified as noise and left out",) if count else ()
    return FileContent(points[~noise] if count else points, notes=notes)


def _records(path: Path, header: Any) -> int | None:
    """Records between the header and what follows the points; None where they are compressed.

    Extended records (EVLR) and waveforms may follow the points, and zeros may fill a block.
    """
    if header.are_points_compressed:
        return None
    begin, size = header.offset_to_point_data, header.point_format.size
    ends = [path.stat().st_size]
    if header.number_of_evlrs:
        ends.append(header.start_of_first_evlr)
    ends += [at for at in (header.start_of_waveform_data_packet_record,) if at > begin]
    end = min(ends)
    stated, held = header.point_count, max(end - begin, 0) // size
    if held > stated:
        with path.open("rb") as file:
            file.seek(begin + stated * size)
            if not file.read(end - file.tell()).strip(b"\0"):
                return stated
    return held


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
    except Exception as error:  # pye57 raises the errors of a C++ library
        raise CloudFileError(f"{path}: not a whole .e57 of {path.stat().st_size} bytes: {error}") from error
    points = np.concatenate(parts) if parts else np.empty((0, 3))
    return FileContent(points, unit="m", frame="enu")
