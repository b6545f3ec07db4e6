"""The folder of a sweep: Zarr arrays over the cases, and a marker for every chunk of them that is complete.

    FOLDER/configuration.json   the study as plain data, the chunk's size, and what is stored
    FOLDER/data.zarr            a group that ``xarray.open_zarr`` reads
    FOLDER/done/000012.json     chunk 12 is complete: a checksum of its values, and times
    FOLDER/ending.json          after how many cases a finished sweep ended, and why

A worker writes the values of a chunk first, and its marker last. A chunk without a marker counts as not computed.
"""

import contextlib
import dataclasses
import json
import os
import re
from typing import Any

import numpy as np

from jaxscp.core.status import STATUS_NAMES
from jaxscp.monte_carlo.errors import SweepError, extra
from jaxscp.monte_carlo.identity import differences
from jaxscp.monte_carlo.outcome import STATUS, STORED, Quantity, checksum

FORMAT = 1
CONFIGURATION, ENDING, LOCK = "configuration.json", "ending.json", "writing.lock"
DATA, DONE = "data.zarr", "done"


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

    def read(self, name: str) -> Any:
        """Content of a JSON file of the folder; None if it is missing or no JSON."""
        fs, root = self.files
        try:
            return json.loads(fs.cat_file(f"{root}/{name}"))
        except (FileNotFoundError, ValueError):
            return None

    def has(self, name: str) -> bool:
        """Whether the folder has such a file."""
        return self.files[0].exists(f"{self.files[1]}/{name}")

    def remove(self, name: str) -> None:
        """Remove a file of the folder, if it is there."""
        fs, root = self.files
        with contextlib.suppress(FileNotFoundError):
            fs.rm_file(f"{root}/{name}")

    def configuration(self) -> dict[str, Any] | None:
        """The configuration; None if the folder holds no sweep.

        Raises:
            SweepError: if it is damaged, or missing beside finished chunks, or of another version of jaxscp.
        """
        stored = self.read(CONFIGURATION)
        if isinstance(stored, dict) and stored.get("format", FORMAT) != FORMAT:
            raise SweepError(f"{self.address}: its format is {stored['format']}, not {FORMAT}.")
        if Layout.readable(stored):
            return stored
        found = self.has(CONFIGURATION)
        if not found and not self.done() and not self.has(ENDING):
            return None
        raise SweepError(
            f"{self.address}: {CONFIGURATION} is {'damaged' if found else 'missing'}, and nothing else says which "
            f"study the folder holds. Restore this file from a copy; or delete the folder {self.address}, and run the "
            "sweep again: it computes all cases."
        )

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
            layout = Layout.of(self.configuration() or {})
            self.check_arrays(layout)
            group = extra("zarr").open_group(f"{self.address}/{DATA}", mode="r+")
            self._arrays = {name: group[name] for name in layout.arrays()}
        return self._arrays

    def check_arrays(self, layout: "Layout") -> None:
        """Raise ``SweepError`` if an array cannot be opened."""
        if names := self._unreadable(layout):
            raise SweepError(
                f"{self.address}: {DATA} is damaged ({names[0]}, say). Run the same sweep again: it computes what is "
                "lost anew."
            )

    def _unreadable(self, layout: "Layout") -> list[str]:
        """Arrays whose metadata are missing, damaged, or of another configuration."""
        zarr = extra("zarr")
        try:
            group = zarr.open_group(f"{self.address}/{DATA}", mode="r")
        except Exception:  # damaged metadata fail with any error
            return list(layout.arrays())

        def sound(name: str) -> bool:
            try:
                array = group[name]
                return (array.shape, array.chunks, str(array.dtype)) == layout.metadata(name)
            except Exception:  # as above
                return False

        return [name for name in layout.arrays() if not sound(name)]

    def repair(self, layout: "Layout") -> list[str]:
        """Make metadata that are missing or damaged anew; values stay, and their checksums decide.

        Returns:
            Names of the arrays.
        """
        fs, root = self.files
        fs.makedirs(f"{root}/{DONE}", exist_ok=True)
        if not self._unreadable(layout):
            return []
        zarr, address = extra("zarr"), f"{self.address}/{DATA}"
        try:
            group = zarr.open_group(address, mode="r+")
        except Exception:  # as above
            self.remove(f"{DATA}/zarr.json")
            group = zarr.open_group(address, mode="a")
        for name in (names := self._unreadable(layout)):
            self.remove(f"{DATA}/{name}/zarr.json")
            layout.create_array(group, name)
        return names or [DATA]

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
        group = extra("zarr").open_group(f"{self.address}/{DATA}", mode="w")
        for name in layout.arrays():
            layout.create_array(group, name)
        self.write(CONFIGURATION, {"format": FORMAT, "study": identity, **dataclasses.asdict(layout)})

    def check(self, stored: dict[str, Any], identity: dict[str, Any]) -> None:
        """Raise ``SweepError`` if the folder holds another study; the message says what differs."""
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
        try:
            found = checksum({name: self.arrays[name][cases] for name in about["names"]})
            whole = found == about["checksum"] and isinstance(about["successes"], int)
        except Exception:  # a damaged file fails in its codec, with any error
            return None
        return about if whole else None

    def done(self) -> list[int]:
        """Chunks that have a marker."""
        fs, root = self.files
        with contextlib.suppress(FileNotFoundError):
            names = fs.ls(f"{root}/{DONE}", detail=False, refresh=True)
            found = [re.search(r"/([0-9]{6,})\.json$", name) for name in names]
            return sorted(int(match[1]) for match in found if match)
        return []


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

    @staticmethod
    def of(stored: dict[str, Any]) -> "Layout":
        """From the configuration of a folder."""
        found = {n: Quantity(d, tuple(s), u, t) for n, (d, s, u, t) in stored["quantities"].items()}
        return Layout(stored["count"], stored["chunk"], stored["parameters"], found)

    @staticmethod
    def readable(stored: Any) -> bool:
        """Whether a configuration has all that ``of`` and results need."""
        try:
            layout = Layout.of(stored)
            arrays = [np.dtype(q.dtype) for q in layout.arrays().values()]
            same = stored["study"]["sampling"].get("count", layout.count) == layout.count
            return same and min(layout.count, layout.chunk, len(arrays)) >= 1
        except Exception:  # any content may stand there
            return False

    def arrays(self) -> dict[str, Quantity]:
        """All arrays by name."""
        found = {name: Quantity("float64", (), unit, False) for name, unit in self.parameters.items()}
        found |= self.quantities
        if any(q.trajectory for q in self.quantities.values()):
            found[STORED] = Quantity("bool", (), "", False)
        return found

    def metadata(self, name: str) -> tuple[tuple[int, ...], tuple[int, ...], str]:
        """Shape, chunks and type of an array."""
        quantity = self.arrays()[name]
        chunks = (self.chunk, *(max(n, 1) for n in quantity.shape))
        return (self.count, *quantity.shape), chunks, quantity.dtype

    def create_array(self, group: Any, name: str) -> None:
        """Make one array in a Zarr group."""
        quantity = self.arrays()[name]
        role = "trajectory" if quantity.trajectory else "parameter" if name in self.parameters else "result"
        attributes: dict[str, Any] = {"role": role}
        if quantity.unit:
            attributes["units"] = quantity.unit
        if name == STATUS and np.issubdtype(quantity.dtype, np.integer):
            attributes["flag_values"] = list(range(len(STATUS_NAMES)))
            attributes["flag_meanings"] = " ".join(STATUS_NAMES)
        shape, chunks, dtype = self.metadata(name)
        group.create_array(
            name,
            shape=shape,
            chunks=chunks,
            dtype=dtype,
            fill_value=np.nan if np.issubdtype(dtype, np.floating) else 0,
            dimension_names=("case", *(f"{name}_{axis}" for axis in range(len(quantity.shape)))),
            attributes=attributes,
        )


def marker(index: int) -> str:
    """File that says that a chunk is complete."""
    return f"{DONE}/{index:06d}.json"
