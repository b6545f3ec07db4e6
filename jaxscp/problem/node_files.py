"""Files of trajectories: an .npz with one array for each field."""

import os
from collections.abc import Mapping

import numpy as np

from jaxscp.core.numpy_files import DAMAGED, HEADER, replacing, why_unreadable

FIELDS = "time", "state", "control", "dilation"
HOLD = "zero_order_hold"


def write(file: str | os.PathLike, arrays: Mapping[str, np.ndarray], hold: tuple[int, ...]) -> None:
    """Write the fields, and the numbers of the controls that are held."""
    held = {HOLD: np.array(hold)} if hold else {}
    with replacing(file) as stream:
        np.savez(stream, allow_pickle=False, **arrays, **held)


def read(file: str | os.PathLike) -> tuple[dict[str, np.ndarray], tuple[int, ...]]:
    """What ``write`` wrote.

    Raises:
        ValueError: if the file is not such an archive or its shapes disagree; the message names the field.
    """
    try:
        # Opened here: NumPy leaves the file open where it is no archive.
        with open(file, "rb") as stream, np.load(stream) as archive:
            missing = [name for name in FIELDS if name not in archive]
            whole = HEADER in archive
            arrays = {name: archive[name] for name in FIELDS if name not in missing}
            hold = tuple(archive[HOLD].tolist()) if HOLD in archive else ()
    except DAMAGED as error:
        raise ValueError(f"{file}: not a trajectory archive (.npz): {why_unreadable(file, error)}") from error
    if missing and whole:
        raise ValueError(
            f"{file}: holds more than a trajectory: call jaxscp.Solution.load(file).trajectory for a solution's"
        )
    if missing:
        raise ValueError(f"{file}: missing field(s) {', '.join(missing)}")
    nodes = arrays["time"].shape[0]
    for name, array in arrays.items():
        if array.shape[0] != nodes:
            raise ValueError(f"{file}: field {name!r} has {array.shape[0]} nodes, but 'time' has {nodes}")
        if array.dtype.kind not in "iuf":
            raise ValueError(f"{file}: field {name!r} holds no numbers")
    if not np.isfinite(arrays["time"]).all() or np.any(np.diff(arrays["time"]) < 0.0):
        raise ValueError(f"{file}: field 'time' does not rise, or holds a value that is NaN or infinite")
    return arrays, hold
