"""Clouds of halls as arrays and as files, and mutations of both."""

import functools
import io
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import jaxscp
from benchmarks.fuzz.case import Case, Ending, any_of, refused
from benchmarks.fuzz.flights import planned
from benchmarks.fuzz.oracle import World
from benchmarks.fuzz.places import hall
from jaxscp.corridor import build_corridor, read_cloud

PLANNER = jaxscp.Planner(nodes=20)
SHAPE = {"polytopes": 8, "faces": 30, "near_points": 8192}
RADIUS = 0.25  # m from points
BETWEEN = 0.15  # m from surfaces that the points, 0.2 m apart, sample
TOUCHING = (
    0.08  # m from surfaces where a mutation took points away, or beside a deck: the vehicle's radius is 0.076
)
VALID_CLOUDS, VALID_FILES = 0.6, 0.3

Points = np.ndarray


def cloud(rng: np.random.Generator) -> Case:
    """A flight through a hall that is known by its points."""
    name = any_of(rng, CLOUDS, VALID_CLOUDS)
    points, solid, start, goal = hall(rng)
    given = CLOUDS[name](points, rng) if name else points
    crop = rng.random() < 0.2
    if crop:
        start[2] = goal[2] = 0.1
    world = World(solid=solid, least=TOUCHING if crop or name else BETWEEN)

    def make():
        decks = [jaxscp.corridor.box(end - 0.4, end + 0.4) for end in (start, goal)] if crop else []
        found = build_corridor(given, start, goal, RADIUS, remove=decks, **SHAPE)
        if not found.found or found.corridor is None:
            raise ValueError(found.message)
        ends = jaxscp.at_rest(start), jaxscp.at_rest(goal)
        return jaxscp.scenarios.through(found.corridor, *ends, near_obstacles=found.near_obstacles), world

    return Case("cloud", name, lambda: planned(make, PLANNER))


def _holes(points: Points, rng: np.random.Generator) -> Points:
    return points[rng.random(len(points)) > 0.5]


def _some_lost(points: Points, rng: np.random.Generator) -> Points:
    points = points.copy()
    points[rng.random(len(points)) < 0.02] = rng.choice([np.nan, np.inf])
    return points


CLOUDS: dict[str, Callable[..., Any]] = {
    "millimetres": lambda p, r: 1000.0 * p,
    "feet of a mile": lambda p, r: p / 1609.0,
    "elsewhere": lambda p, r: p + r.choice([-1, 1], 3) * 10.0 ** r.uniform(2, 6),
    "transposed": lambda p, r: p.T,
    "z down": lambda p, r: p * [1.0, -1.0, -1.0],
    "four columns": lambda p, r: np.column_stack([p, r.random(len(p))]),
    "two columns": lambda p, r: p[:, :2],
    "numbered": lambda p, r: np.column_stack([np.arange(len(p)), p[:, :2]]),
    "no usable point": lambda p, r: np.full_like(p, np.nan),
    "points lost": _some_lost,
    "sparse": _holes,
    "an outlier": lambda p, r: np.concatenate([p, 10.0 ** r.uniform(2, 5) * np.sign(r.normal(size=(1, 3)))]),
    "noise": lambda p, r: p + r.normal(0.0, 0.02, p.shape),
    "twice": lambda p, r: np.concatenate([p, p]),
    "in disorder": lambda p, r: r.permutation(p),
    "single precision": lambda p, r: p.astype(np.float32),
    "rounded to centimetres": lambda p, r: np.round(p, 2),
    "a list": lambda p, r: p[::7].tolist(),
}


def file(rng: np.random.Generator) -> Case:
    """A file of points: read as written, or damaged; a damaged one is refused, or read as something."""
    form = str(rng.choice(list(FORMATS)))
    name = any_of(rng, BYTES, VALID_FILES)
    points = np.round(hall(rng)[0][:: int(rng.integers(1, 8))], 3)
    content = FORMATS[form](points)
    damaged = BYTES[name](content, rng) if name else content

    def run() -> Ending:
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            path = Path(folder) / f"hall.{form.partition(' ')[0]}"
            path.write_bytes(damaged)
            return _read(path, None if name else points)

    return Case("file", name, run)


def _read(path: Path, expected: Points | None) -> Ending:
    try:
        found = read_cloud(path)
    except (ValueError, OSError, ImportError) as error:
        if path.name not in str(error):
            return Ending("traceback", f"the message does not name the file: {error}")
        return refused(error)
    if not np.isfinite(found.points).all():
        return Ending("nan", "the cloud holds NaN")
    if expected is None:
        return Ending("read", f"{found.count} points")
    same = found.points.shape == expected.shape and np.allclose(found.points, expected, atol=1e-3)
    return (
        Ending("accepted")
        if same
        else Ending("refuted", f"read {found.points.shape}, wrote {expected.shape}")
    )


def _text(points: Points, separator: str, head: str = "") -> bytes:
    stream = io.StringIO()
    np.savetxt(stream, points, fmt="%.3f", delimiter=separator)
    return (head + stream.getvalue()).encode()


def _npy(points: Points) -> bytes:
    stream = io.BytesIO()
    np.save(stream, points)
    return stream.getvalue()


def _pcd(points: Points, data: str) -> bytes:
    head = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        f"WIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA {data}\n"
    )
    return head.encode() + (points.astype("<f4").tobytes() if data == "binary" else _text(points, " "))


def _ply(points: Points, form: str) -> bytes:
    head = f"ply\nformat {form} 1.0\nelement vertex {len(points)}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    return head.encode() + (_text(points, " ") if form == "ascii" else points.astype("<f4").tobytes())


FORMATS: dict[str, Callable[[Points], bytes]] = {
    "xyz": functools.partial(_text, separator=" "),
    "txt": functools.partial(_text, separator="\t", head="x\ty\tz\n"),
    "csv": functools.partial(_text, separator=",", head="x,y,z\n"),
    "npy": _npy,
    "pcd ascii": functools.partial(_pcd, data="ascii"),
    "pcd binary": functools.partial(_pcd, data="binary"),
    "ply ascii": functools.partial(_ply, form="ascii"),
    "ply binary": functools.partial(_ply, form="binary_little_endian"),
}


def _flipped(content: bytes, rng: np.random.Generator) -> bytes:
    numbers = np.frombuffer(content, np.uint8).copy()
    numbers[rng.integers(len(numbers), size=rng.integers(1, 20))] = rng.integers(256)
    return numbers.tobytes()


def _in_head(content: bytes, rng: np.random.Generator) -> bytes:
    numbers = np.frombuffer(content, np.uint8).copy()
    numbers[rng.integers(min(len(numbers), 200), size=rng.integers(1, 4))] = rng.integers(32, 127)
    return numbers.tobytes()


def _inserted(content: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(len(content)))
    return content[:at] + rng.bytes(int(rng.integers(1, 50))) + content[at:]


def _word(content: bytes, rng: np.random.Generator) -> bytes:
    words = content.split(b" ")
    wrong = [b"nan", b"inf", b"-1", b"0", b"1e999", b"99999999999", b"word", b"", "ü".encode("latin-1")]
    words[int(rng.integers(len(words)))] = wrong[int(rng.integers(len(wrong)))]
    return b" ".join(words)


BYTES: dict[str, Callable[[bytes, np.random.Generator], bytes]] = {
    "cut short": lambda c, r: c[: int(r.integers(len(c)))],
    "bytes flipped": _flipped,
    "bytes of the head": _in_head,
    "bytes inserted": _inserted,
    "a wrong word": _word,
    "empty": lambda c, r: b"",
    "only the head": lambda c, r: c[: int(r.integers(1, 200))],
    "lines of Windows": lambda c, r: c.replace(b"\n", b"\r\n"),
    "a mark of byte order": lambda c, r: b"\xef\xbb\xbf" + c,
    "twice": lambda c, r: c + c,
    "noise": lambda c, r: r.bytes(500),
}
