"""A way through a space on a voxel grid, or the reason why there is none."""

from typing import NamedTuple

import equinox as eqx
import numpy as np
import scipy
from jaxtyping import Bool, Float

from jaxscp.core.extras import of_extra
from jaxscp.corridor.limits import Point
from jaxscp.corridor.search_space import Space

Waypoints = Float[np.ndarray, "vertices 3"]
Field = Float[np.ndarray, "x y z"]
Cells = Bool[np.ndarray, "x y z"]

_CELLS_AT_FIRST = 300_000
FINEST = 0.05


class Blocked(eqx.Module):
    """Why a search on one grid found no way."""

    reason: str
    proven: bool
    """Whether finer voxels cannot help either."""


class Grid(NamedTuple):
    """Voxel centres that fill the limits evenly; none is outside."""

    centres: list[Float[np.ndarray, "n"]]
    """Coordinates of the centres along each axis, metres."""
    step: Float[np.ndarray, "3"]
    """Distances between neighbours along each axis, metres."""
    edge: float
    """Edge that was asked for, metres."""

    @staticmethod
    def over(space: Space, edge: float) -> "Grid":
        """Grid over a space with voxels of about one edge."""
        shape = np.ceil((space.upper - space.lower) / edge).astype(int) + 1
        corners = zip(space.lower, space.upper, shape, strict=True)
        centres = [np.linspace(low, high, count) for low, high, count in corners]
        step = np.array([axis[1] - axis[0] if axis.size > 1 else edge for axis in centres])
        return Grid(centres, step, edge)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of voxels along each axis."""
        return tuple(axis.size for axis in self.centres)

    @property
    def half(self) -> float:
        """Half the diagonal of a voxel, metres."""
        return 0.5 * float(np.linalg.norm(self.step))

    def places(self, voxels: np.ndarray) -> Float[np.ndarray, "voxels 3"]:
        """Centres of voxels, metres."""
        return np.stack([axis[voxels[:, i]] for i, axis in enumerate(self.centres)], axis=1)

    def safe(self, keep: float) -> float:
        """Distance that both ends of an edge of the grid need for the whole edge to keep another."""
        return float(np.hypot(keep, self.half))


def cell_count(space: Space, edge: float) -> float:
    """Number of voxels of an edge that fill a space."""
    return float(np.prod(np.ceil((space.upper - space.lower) / edge) + 1))


def first_edge(space: Space) -> float:
    """Edge of voxels no larger than the gaps that matter, unless that makes too many of them, metres."""
    by_number = float(np.cbrt(np.prod(np.maximum(space.upper - space.lower, FINEST)) / _CELLS_AT_FIRST))
    return max(by_number, min(0.2, max(0.5 * space.radius, FINEST)))


def search(space: Space, start: Point, goal: Point, edge: float) -> Waypoints | Blocked:
    """Voxel path between the two ends, or why there is none.

    Raises:
        ImportError: scikit-image is not installed.
    """
    graph = of_extra("skimage.graph", "clouds", "the route search needs scikit-image")
    grid = Grid.over(space, edge)
    limits = space.to_limits(np.stack(np.meshgrid(*grid.centres, indexing="ij"), axis=-1))
    distance = np.minimum(_distance(space, grid), limits)
    free = distance >= grid.safe(space.roomy)
    ends = [_entrances(k, point, space, grid, free) for k, point in enumerate((start, goal))]
    for name, end in zip(("start", "goal"), ends, strict=True):
        if not len(end):
            return Blocked(_hemmed_in(name, space, edge), proven=False)
    finder = graph.MCP_Geometric(np.where(free, 1.0, -1.0), sampling=tuple(grid.step))
    reached, _ = finder.find_costs(
        [tuple(c) for c in ends[0]], [tuple(c) for c in ends[1]], find_all_ends=False
    )
    costs = reached[tuple(ends[1].T)]
    best = int(np.argmin(costs))
    if not np.isfinite(costs[best]):
        squeezed = _connected(distance >= grid.safe(space.radius), ends)
        reason = _walled_off(free, ends, grid, space, squeezed)
        return Blocked(reason, proven=_proven(space, np.stack([start, goal]), distance, grid))
    path = np.array(finder.traceback(tuple(ends[1][best])))
    return np.concatenate([start[None], grid.places(path), goal[None]])


def _hemmed_in(name: str, space: Space, edge: float) -> str:
    size = " x ".join(f"{length:.3g}" for length in space.upper - space.lower)
    return (
        f"{name} is hemmed in: it sees no place that keeps {space.roomy:.3g} m from every point (voxels of {edge:.3g} "
        f"m in a volume of {size} m; closer limits make finer voxels: lower= and upper= (--lower, --upper))"
    )


def _distance(space: Space, grid: Grid) -> Field:
    """Distance of every voxel centre from the nearest point, exact where it decides anything."""
    if space.tree is None:
        return np.full(grid.shape, np.inf)
    # A distance transform between voxels, padded for points just outside, is off by half a diagonal at most.
    pad = np.ceil(space.roomy / grid.step).astype(int) + 1
    occupied = np.zeros(np.array(grid.shape) + 2 * pad, bool)
    place = np.rint((space.points - space.lower) / grid.step).astype(int) + pad
    place = place[np.all((place >= 0) & (place < occupied.shape), axis=1)]
    occupied[tuple(place.T)] = True
    if not occupied.any():
        return np.full(grid.shape, np.inf)
    away = scipy.ndimage.distance_transform_edt(~occupied, sampling=tuple(grid.step))
    away = np.asarray(away)[tuple(slice(p, p + n) for p, n in zip(pad, grid.shape, strict=True))]
    doubtful = np.argwhere((away > space.radius - grid.half) & (away < grid.safe(space.roomy) + grid.half))
    distance = np.where(away <= space.radius - grid.half, 0.0, away)
    distance[tuple(doubtful.T)] = space.to_points(grid.places(doubtful))
    return distance


def _entrances(end: int, point: Point, space: Space, grid: Grid, free: Cells) -> np.ndarray:
    """Free voxels that a straight flight from an end reaches, with the clearance if the end has it."""
    keep = space.roomy if float(space.distance(point[None])[0]) >= space.roomy else space.radius
    shape = np.array(free.shape)
    nearest = np.rint((point - space.lower) / grid.step).astype(int)
    for reach in (1, 2, 4):
        low, high = np.maximum(nearest - reach, 0), np.minimum(nearest + reach + 1, shape)
        block = np.argwhere(free[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]) + low
        places = grid.places(block)
        order = np.argsort(np.linalg.norm(places - point, axis=1))[:64]
        seen = [i for i in order if space.from_end(end, point, places[i]) >= keep]
        if seen:
            return block[seen]
    return np.empty((0, 3), int)


def _regions(free: Cells) -> np.ndarray:
    return np.asarray(scipy.ndimage.label(free, structure=np.ones((3, 3, 3)))[0])  # pyright: ignore[reportIndexIssue]


def _connected(free: Cells, ends: list[np.ndarray]) -> bool:
    regions = _regions(free)
    first, last = (set(np.unique(regions[tuple(end.T)])) - {0} for end in ends)
    return bool(first & last)


def _proven(space: Space, ends: Float[np.ndarray, "2 3"], distance: Field, grid: Grid) -> bool:
    """Whether no way exists at all: one would only pass voxels that are at most half a diagonal nearer."""
    if any(deck is not None for deck in space.decks):
        return False
    tight = bool(np.any(space.distance(ends) < space.roomy))
    keep = (space.radius if tight else space.roomy) - grid.half
    return not _connected(
        distance >= keep, list(np.rint((ends - space.lower) / grid.step).astype(int)[:, None])
    )


def _walled_off(free: Cells, ends: list[np.ndarray], grid: Grid, space: Space, squeezed: bool) -> str:
    """Why there is no way: the volume that each end can reach, or the clearance."""
    if squeezed:
        return (
            f"a way keeps the safety radius of {space.radius:.3g} m, but none leaves the clearance of "
            f"{space.roomy - space.radius:.3g} m besides: ask for less clearance, clearance=0.05 say "
            f"(--clearance 0.05; voxels of {grid.edge:.3g} m)"
        )
    regions = _regions(free)
    volume = float(np.prod(grid.step))
    sizes = [np.isin(regions, np.unique(regions[tuple(end.T)])).sum() * volume for end in ends]
    return (
        f"no way from start to goal keeps {space.roomy:.3g} m from every point: start reaches "
        f"{sizes[0]:.3g} m^3, goal {sizes[1]:.3g} m^3, and these do not touch (voxels of {grid.edge:.3g} m). The "
        f"search is limited to {_words(space.lower)} to {_words(space.upper)} m; a way outside needs lower= and upper= "
        "(--lower, --upper)"
    )


def _words(corner: Point) -> str:
    return f"({', '.join(f'{value:.4g}' for value in corner)})"
