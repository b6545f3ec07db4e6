"""The folder of a sweep: Zarr arrays over the cases, and a marker for every chunk of them that is complete.

    FOLDER/configuration.json   the study as plain data, the chunk's size, and what is stored
    FOLDER/data.zarr            a group that ``xarray.open_zarr`` reads
    FOLDER/done/000012.json     chunk 12 is complete: a checksum of its values, and times
    FOLDER/ending.json          after how many cases a finished sweep ended, and why

A worker writes the values of a chunk first, and its marker last. A chunk without a marker counts as not computed.
"""

import dataclasses
import hashlib
import json
import os
from typing import Any

import numpy as np

from jaxscp.core.status import STATUS_NAMES
from jaxscp.monte_carlo.errors import SweepError, extra
from jaxscp.monte_carlo.identity import differences
from jaxscp.monte_carlo.outcome import STATUS, Quantity

FORMAT = 1
CONFIGURATION, ENDING, LOCK = "configuration.json", "ending.json", "writing.lock"
DATA, DONE = "data.zarr", "done"
STORED = "trajectory_stored"


class Store:
    """A sweep's folder; pickles, so that workers open it themselves.

    Args:
        address: a folder, or any address of fsspec: ``"s3://bucket/study"``, say.
    """

    def __init__(self, address: str | os.PathLike):
        self.address = os.fspath(address).rstrip("/")
        self._arrays: dict[str, Any] | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {"address": self.address, "_arrays": None}

    @property
    def files(self) -> Any:
        """The file system, and below it the folder's path."""
        return extra("fsspec.core").url_to_fs(self.address)

    @property
    def local(self) -> bool:
        """Whether the folder lies on a file system of this machine."""
        return "://" not in self.address or self.address.startswith("file://")

    def read(self, name: str) -> dict[str, Any] | None:
        """A JSON file of the folder; None if it is missing or damaged."""
        fs, root = self.files
        try:
            return json.loads(fs.cat_file(f"{root}/{name}"))
        except (FileNotFoundError, ValueError):
            return None

    def write(self, name: str, content: dict[str, Any]) -> None:
        """Write a JSON file of the folder at once: under another name first, where a file system allows that."""
        fs, root = self.files
        data = json.dumps(content, indent=1).encode()
        if not self.local:
            fs.pipe_file(f"{root}/{name}", data)  # object stores show whole objects only
            return
        part = f"{root}/{name}.{os.getpid()}.part"
        fs.pipe_file(part, data)
        os.replace(part, f"{root}/{name}")

    @property
    def arrays(self) -> dict[str, Any]:
        """The Zarr arrays by name, opened once a process."""
        if self._arrays is None:
            self._arrays = dict(extra("zarr").open_group(f"{self.address}/{DATA}", mode="r+").arrays())
        return self._arrays

    def check_empty(self) -> None:
        """Raise ``SweepError`` if the folder holds other files."""
        fs, root = self.files
        paths = fs.ls(root, detail=False) if fs.exists(root) else []
        names = [path.rstrip("/").rpartition("/")[2] for path in paths]
        if other := [name for name in names if name not in (DATA, DONE, LOCK) and not name.endswith(".part")]:
            raise SweepError(
                f"{self.address}: holds other files ({other[0]}, say) and no sweep; name a new folder."
            )

    def create(self, identity: dict[str, Any], layout: "Layout") -> None:
        """Make the arrays, and write the configuration last."""
        fs, root = self.files
        fs.makedirs(f"{root}/{DONE}", exist_ok=True)
        layout.create(f"{self.address}/{DATA}")
        self.write(CONFIGURATION, {"format": FORMAT, "study": identity, **layout.plain()})

    def check(self, stored: dict[str, Any], identity: dict[str, Any]) -> None:
        """Raise ``SweepError`` if the folder holds another study; the message says what differs."""
        if stored.get("format") != FORMAT:
            raise SweepError(
                f"{self.address}: has the format {stored.get('format')}, and this version reads {FORMAT}."
            )
        if lines := differences(stored["study"], json.loads(json.dumps(identity))):
            raise SweepError(
                f"{self.address}: holds another sweep. Old and new results do not mix; name a new folder, or restore "
                "what differs:\n  " + "\n  ".join(lines[:8])
            )

    def write_values(self, start: int, values: dict[str, np.ndarray]) -> None:
        """Write the values of a chunk.

        Args:
            start: number of its first case.
            values: by name, (cases of the chunk, ...) each; trajectories that are not stored are missing.
        """
        for name, array in values.items():
            self.arrays[name][start : start + len(array)] = array

    def write_marker(self, index: int, values: dict[str, np.ndarray], facts: dict[str, Any]) -> None:
        """Say that a chunk is complete, after its values; with facts about it."""
        self.write(marker(index), {"checksum": checksum(values), "names": sorted(values), **facts})

    def facts(self, index: int, cases: slice) -> dict[str, Any] | None:
        """Facts about a chunk with a marker that reads back with its checksum; None of a damaged one."""
        about = self.read(marker(index))
        if about is None:
            return None
        try:
            found = checksum({name: self.arrays[name][cases] for name in about["names"]})
        except Exception:  # a damaged file fails in its codec, with any error
            return None
        return about if found == about["checksum"] else None

    def done(self) -> list[int]:
        """Chunks that have a marker."""
        fs, root = self.files
        try:
            names = fs.ls(f"{root}/{DONE}", detail=False, refresh=True)
        except FileNotFoundError:
            return []
        stems = [name.rpartition("/")[2] for name in names if name.endswith(".json")]
        return sorted(int(stem.removesuffix(".json")) for stem in stems)


@dataclasses.dataclass(frozen=True)
class Layout:
    """Arrays of a sweep.

    Args:
        count: number of cases.
        chunk: cases a chunk.
        parameters: units of the parameters, by name.
        quantities: stored for every case, by name.
    """

    count: int
    chunk: int
    parameters: dict[str, str]
    quantities: dict[str, Quantity]

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return -(-self.count // self.chunk)

    def cases(self, index: int) -> slice:
        """Cases of a chunk."""
        return slice(index * self.chunk, min((index + 1) * self.chunk, self.count))

    def plain(self) -> dict[str, Any]:
        """For JSON."""
        return dataclasses.asdict(self)

    @staticmethod
    def of(stored: dict[str, Any]) -> "Layout":
        """From the configuration of a folder."""
        found = {n: Quantity(d, tuple(s), u, t) for n, (d, s, u, t) in stored["quantities"].items()}
        return Layout(stored["count"], stored["chunk"], stored["parameters"], found)

    def create(self, address: str) -> None:
        """Make the arrays, all of fill values."""
        zarr = extra("zarr")
        group = zarr.open_group(address, mode="w")
        for name, unit in self.parameters.items():
            self._array(group, name, Quantity("float64", (), unit, False), {"role": "parameter"})
        for name, quantity in self.quantities.items():
            self._array(group, name, quantity, {"role": "trajectory" if quantity.trajectory else "result"})
        if any(q.trajectory for q in self.quantities.values()):
            self._array(group, STORED, Quantity("bool", (), "", False), {"role": "result"})

    def _array(self, group: Any, name: str, quantity: Quantity, attributes: dict[str, Any]) -> None:
        if quantity.unit:
            attributes["units"] = quantity.unit
        if name == STATUS and np.issubdtype(quantity.dtype, np.integer):
            attributes["flag_values"] = list(range(len(STATUS_NAMES)))
            attributes["flag_meanings"] = " ".join(STATUS_NAMES)
        inner = tuple(f"{name}_{axis}" for axis in range(len(quantity.shape)))
        group.create_array(
            name,
            shape=(self.count, *quantity.shape),
            chunks=(self.chunk, *(max(n, 1) for n in quantity.shape)),
            dtype=quantity.dtype,
            fill_value=np.nan if np.issubdtype(quantity.dtype, np.floating) else 0,
            dimension_names=("case", *inner),
            attributes=attributes,
        )


def marker(index: int) -> str:
    """File that says that a chunk is complete."""
    return f"{DONE}/{index:06d}.json"


def checksum(values: dict[str, np.ndarray]) -> str:
    """SHA-256 of names and values."""
    digest = hashlib.sha256()
    for name in sorted(values):
        array = np.ascontiguousarray(values[name])
        digest.update(f"{name} {array.dtype} {array.shape} ".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
