"""A point cloud: positions in metres, and a record of points dropped and thinned."""

import warnings
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int, UInt32
from numpy.typing import ArrayLike

from jaxscp.core.arrays import unit_lengths
from jaxscp.corridor.conventions import metres, to_z_up
from jaxscp.corridor.extent import corners, main_box
from jaxscp.corridor.polytope import Polytope

_SUSPICIOUS_EXTENT = 10_000.0


class Provenance(NamedTuple):
    """The file that a cloud was read from, if any, and the facts about the cloud that were stated."""

    file: str | None
    """Path of the file; None for an array."""
    unit: str | None = None
    """The unit that the file or the caller stated; None where metres were assumed."""
    frame: str | None = None
    """The frame that the file or the caller stated; None where z up was assumed."""
    notes: tuple[str, ...] = ()
    """Assumptions made while reading."""
    doubts: tuple[str, ...] = ()
    """Questions that the file leaves open."""


class PointCloud(eqx.Module):
    """Obstacle points, on the host.

    A thinned cloud stands for the points it was thinned from: each of those lies within ``spread`` of one
    that is left, so a distance of ``radius + spread`` from these keeps ``radius`` from all.

    Example:
        >>> cloud = PointCloud.of([[0.0, 0.0, 0.0], [0.04, 0.0, 0.0], [5.0, 0.0, 0.0]])
        >>> thinned = cloud.thinned(0.1)
        >>> cloud.count, thinned.count, thinned.spread
        (3, 2, 0.02)
    """

    points: Float[np.ndarray, "points 3"]
    """Positions, (points, 3), metres."""
    spread: float = 0.0
    """How far an original point can be from the one that stands for it, metres."""
    dropped: int = 0
    """How many points were left out because a coordinate was not finite."""
    provenance: Provenance | None = eqx.field(static=True, default=None)
    """The file that the points came from, and its stated unit and frame; None for an array in metres, z up."""

    @staticmethod
    def of(
        points: ArrayLike, source: str = "the cloud", *, unit: str | None = None, frame: str | None = None
    ) -> "PointCloud":
        """A cloud from any (points, 3) array; points that are not finite are dropped and counted.

        Warns when points were dropped, and when the extent suggests that the unit is not the metre.

        Args:
            points: (points, 3) positions.
            source: name of the points in messages.
            unit: m, dm, cm, mm, km, in, ft or us-ft. None assumes metres, and maps that contradict them are refused.
            frame: enu or flu (z up), ned or frd (z down), or y-up. None assumes z up, as with the unit.

        Raises:
            ValueError: the shape is not (points, 3), or the unit or frame is unknown.

        Example:
            >>> PointCloud.of([[1000.0, 0.0, -2000.0]], unit="mm", frame="frd").points.tolist()
            [[1.0, 0.0, 2.0]]
        """
        try:
            array = np.asarray(points, float)
        except (TypeError, ValueError):
            hint = "; read_cloud reads a file" if isinstance(points, str) else ""
            raise ValueError(
                f"{source}: expected an array of shape (points, 3), got {points!r:.80}{hint}"
            ) from None
        if array.size == 0:
            array = array.reshape(0, 3)
        if array.ndim != 2 or array.shape[1] != 3:
            raise ValueError(f"{source}: expected an array of shape (points, 3), got {array.shape}")
        dropped = 0
        if array.shape[0] and not np.isfinite(corners(array)).all():
            finite = np.isfinite(array).all(axis=1)
            dropped = int(array.shape[0] - np.count_nonzero(finite))
            warnings.warn(f"{source}: dropped {dropped} of {array.shape[0]} points, not finite", stacklevel=2)
            array = array[finite]
        if unit is not None:
            array = array * metres(unit)
        if frame is not None:
            array = array @ to_z_up(frame).T + 0.0  # no negative zeros
        _warn_of_units(array, source)
        origin = None if unit is None and frame is None else Provenance(None, unit, frame)
        return PointCloud(array, 0.0, dropped, origin)

    @staticmethod
    def at(points: "PointCloud | ArrayLike") -> "PointCloud":
        """The cloud itself, or one of an array of points, as ``of`` makes it."""
        return points if isinstance(points, PointCloud) else PointCloud.of(points)

    @property
    def file(self) -> str | None:
        """The file that the points came from; None for an array."""
        return None if self.provenance is None else self.provenance.file

    @property
    def count(self) -> int:
        """Number of points."""
        return self.points.shape[0]

    @property
    def extent(self) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        """Lower and upper corner of the points in metres; of an empty cloud, twice the origin."""
        if self.count == 0:
            return np.zeros(3), np.zeros(3)
        return corners(self.points)

    def thinned(self, voxel: float) -> "PointCloud":
        """One point a voxel: the middle of the box that its points span.

        The spread grows by half that box's diagonal, at most half the voxel's.

        Args:
            voxel: edge of a voxel, metres.

        Raises:
            ValueError: the voxel is not positive.
        """
        if not voxel > 0:
            raise ValueError(f"voxel must be positive, got {voxel} m")
        if self.count == 0:
            return self
        order, first = _by_voxel(self.points, voxel)
        ordered = np.take(self.points, order, axis=0)
        lower, upper = (of.reduceat(ordered, first, axis=0) for of in (np.minimum, np.maximum))
        spread = 0.5 * float(np.linalg.norm(upper - lower, axis=1).max())
        return PointCloud(0.5 * (lower + upper), self.spread + spread, self.dropped, self.provenance)

    def inside(self, region: Polytope, margin: float = 0.0) -> Bool[np.ndarray, "points"]:
        """Which points lie in a polytope grown by a margin in metres; normals may have any length."""
        left = np.arange(self.count)
        normals = np.asarray(region.normals)
        limits = np.asarray(region.offsets) + margin * unit_lengths(normals)
        for normal, limit in zip(normals, limits, strict=True):
            # Most points fall to the first faces, which keeps millions of them within memory.
            left = left[self.points[left] @ normal <= limit]
        inside = np.zeros(self.count, bool)
        inside[left] = True
        return inside

    def without(self, region: Polytope) -> "PointCloud":
        """The cloud less the points in a polytope: the carrier's own deck, say, is no obstacle to land on.

        Example:
            >>> import jaxscp
            >>> deck = jaxscp.corridor.box([-1.0, -1.0, 0.0], [1.0, 1.0, 0.2])
            >>> PointCloud.of([[0.0, 0.0, 0.1], [3.0, 0.0, 0.0]]).without(deck).count
            1
        """
        return self.chosen(~self.inside(region))

    def chosen(self, rows: Bool[np.ndarray, "points"]) -> "PointCloud":
        """The points that a mask chooses."""
        return PointCloud(self.points[rows], self.spread, self.dropped, self.provenance)


def _by_voxel(points: Float[np.ndarray, "points 3"], voxel: float) -> tuple[np.ndarray, np.ndarray]:
    """An order that puts points of one voxel together, and where each voxel begins in it."""
    low, high = corners(points)
    sizes = np.floor((high - low) / voxel) + 1.0
    if np.prod(sizes) >= 2.0**62:
        cells = np.floor((points - low) / voxel)
        order = np.lexsort(cells.T)
        changed = np.any(np.diff(cells[order], axis=0) != 0, axis=1)
    else:
        kind = np.uint32 if np.prod(sizes) < 2.0**32 else np.int64
        key = np.zeros(len(points), kind)
        for axis in range(3):
            key *= kind(sizes[axis])
            key += np.floor((points[:, axis] - low[axis]) / voxel).astype(kind)
        order = _sorted(key) if kind is np.uint32 else np.argsort(key)
        key = key[order]
        changed = key[1:] != key[:-1]
    return order, np.concatenate([[0], np.flatnonzero(changed) + 1])


def _sorted(key: UInt32[np.ndarray, "points"]) -> Int[np.ndarray, "points"]:
    """An order that sorts: NumPy sorts numbers of 16 bits by radix, twice of which takes two thirds of one sort."""
    low = np.argsort(key.astype(np.uint16), kind="stable")
    high = (key >> 16).astype(np.uint16)
    return low[np.argsort(high[low], kind="stable")]


def _warn_of_units(points: np.ndarray, source: str) -> None:
    if points.shape[0] == 0:
        return
    box = main_box(points)
    extent = float((box.upper - box.lower).max())
    if extent > _SUSPICIOUS_EXTENT:
        warnings.warn(
            f"{source}: the points span {extent:.0f} m. Are they in millimetres, or is there an outlier? "
            "Positions must be in metres; of a file, state the unit: unit='mm' (--unit mm).",
            stacklevel=3,
        )
