"""Maps to fly through, made from a seed: pillars, forest, caves of Perlin noise, an office with rooms.

Every map is a cloud of surface points about ``spacing`` apart, the volume that may be flown in, and two
places far apart and clear of obstacles. Whether a way joins them is left to chance, as it is outside.
"""

from collections.abc import Callable, Iterable
from itertools import product

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from jaxscp.corridor.clouds import PointCloud

Points = Float[np.ndarray, "points 3"]
Point = Float[np.ndarray, "3"]


class Map(eqx.Module):
    """Obstacles, limits and two places in one frame: metres, z up."""

    name: str = eqx.field(static=True)
    """Kind of map."""
    cloud: PointCloud
    """Points on the surfaces of obstacles."""
    lower: Point
    """Lower corner of the volume that may be flown in, (3,), metres."""
    upper: Point
    """Its upper corner, (3,), metres."""
    start: Point
    """A clear place near one side, (3,), metres."""
    goal: Point
    """A clear place near the opposite side, (3,), metres."""


def pillars(seed: int, *, count: int = 40, spacing: float = 0.1, clear: float = 0.6) -> Map:
    """Round pillars of 0.2 to 0.6 m radius in a hall of 20 x 20 x 4 m.

    Args:
        seed: the same one makes the same map.
        count: pillars.
        spacing: between points, metres.
        clear: distance of start and goal from every point, metres.

    Example:
        >>> import numpy as np
        >>> one, same = pillars(3), pillars(3)
        >>> bool(np.array_equal(one.cloud.points, same.cloud.points))
        True
    """
    rng = np.random.default_rng(seed)
    size = np.array([20.0, 20.0, 4.0])
    feet = rng.uniform([2.0, 0.0], [18.0, 20.0], size=(count, 2))
    radii = rng.uniform(0.2, 0.6, count)
    parts = [
        _tube(np.append(f, 0.0), np.append(f, size[2]), r, r, spacing)
        for f, r in zip(feet, radii, strict=True)
    ]
    return _finished("pillars", rng, parts, size, clear)


def forest(seed: int, *, count: int = 40, spacing: float = 0.1, clear: float = 0.6) -> Map:
    """Leaning, tapered trunks with round crowns on level ground, 24 x 24 x 7 m.

    Args:
        seed: the same one makes the same map.
        count: trees.
        spacing: between points, metres.
        clear: distance of start and goal from every point, metres.

    Example:
        >>> bool(forest(0).cloud.points[:, 2].min() >= 0.0)
        True
    """
    rng = np.random.default_rng(seed)
    size = np.array([24.0, 24.0, 7.0])
    parts = [_rectangle(np.zeros(3), np.array([size[0], 0, 0]), np.array([0, size[1], 0]), 2 * spacing)]
    for _ in range(count):
        foot = np.append(rng.uniform([2.0, 0.0], [22.0, 24.0]), 0.0)
        top = foot + np.append(rng.normal(0.0, 0.5, 2), rng.uniform(3.0, 6.0))
        radius = rng.uniform(0.12, 0.35)
        parts.append(_tube(foot, top, radius, 0.5 * radius, spacing))
        parts.append(_ball(top, rng.uniform(0.6, 1.4), spacing))
    return _finished("forest", rng, parts, size, clear)


def perlin(seed: int, *, fill: float = 0.25, spacing: float = 0.2, clear: float = 0.6) -> Map:
    """Caves: where two octaves of gradient noise are largest there is rock, 20 x 20 x 6 m.

    Args:
        seed: the same one makes the same map.
        fill: share of the volume that is rock.
        spacing: edge of the voxels whose visible ones become points, metres.
        clear: distance of start and goal from every point, metres.

    Example:
        >>> perlin(0, fill=0.1).cloud.count < perlin(0, fill=0.3).cloud.count
        True
    """
    rng = np.random.default_rng(seed)
    size = np.array([20.0, 20.0, 6.0])
    axes = [np.arange(0.5 * spacing, extent, spacing) for extent in size]
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    noise = _gradient_noise(rng, places / 4.0) + 0.5 * _gradient_noise(rng, places / 2.0)
    rock = noise > np.quantile(noise, 1.0 - fill)
    return _finished("perlin", rng, [places[_surface(rock)]], size, clear)


def office(seed: int, *, rooms: int = 3, spacing: float = 0.1, clear: float = 0.45) -> Map:
    """A square of rooms of 5 x 5 x 3 m with doors, floor, ceiling and furniture.

    Doors, 1.2 m wide and 2.2 m high, join every room to the others; a few more make rounds possible. Desks
    and cupboards leave the middle of each room alone.

    Args:
        seed: the same one makes the same map.
        rooms: along each side.
        spacing: between points, metres.
        clear: distance of start and goal from every point, metres.

    Example:
        >>> office(1, rooms=2).upper.tolist()
        [10.0, 10.0, 3.0]
    """
    rng = np.random.default_rng(seed)
    edge, height = 5.0, 3.0
    size = np.array([rooms * edge, rooms * edge, height])
    across, along = np.array([size[0], 0, 0]), np.array([0, size[1], 0])
    parts = [_rectangle(np.array([0, 0, z]), across, along, 2 * spacing) for z in (0.0, height)]
    doors = _doors(rng, rooms)
    for axis, line, cell in product((0, 1), range(rooms + 1), range(rooms)):
        wall = _wall(axis, line * edge, cell * edge, edge, height, spacing)
        if (axis, line, cell) in doors:
            middle = cell * edge + rng.uniform(1.2, edge - 1.2)
            opening = (np.abs(wall[:, 1 - axis] - middle) < 0.6) & (wall[:, 2] < 2.2)
            wall = wall[~opening]
        parts.append(wall)
    for i, j in product(range(rooms), repeat=2):
        corner = np.array([i * edge, j * edge, 0.0])
        for _ in range(rng.integers(0, 3)):
            shape = rng.uniform([0.5, 0.5, 0.6], [1.2, 1.2, 2.0])
            side = rng.integers(0, 2, 2)
            foot = np.append(np.where(side, edge - 0.8 - shape[:2], 0.8), 0.0)
            parts.append(_block(corner + foot, shape, spacing))
    return _finished("office", rng, parts, size, clear)


KINDS: dict[str, Callable[[int], Map]] = {
    "pillars": pillars,
    "forest": forest,
    "perlin": perlin,
    "office": office,
}
"""The generators by name, each called with a seed."""


def _finished(
    name: str, rng: np.random.Generator, parts: Iterable[np.ndarray], size: Point, clear: float
) -> Map:
    """Cut to the limits, and find a clear place in the first and the last seventh of the hall."""
    points = np.concatenate(list(parts))
    points = points[np.all((points >= 0.0) & (points <= size), axis=1)]
    tree = KDTree(points)
    margin = np.array([0.5, 0.5, 0.8])

    def clear_place(low: float, high: float) -> Point:
        for _ in range(10_000):
            place = rng.uniform(margin, size - margin)
            place[0] = rng.uniform(max(low * size[0], margin[0]), min(high * size[0], size[0] - margin[0]))
            if tree.query(place)[0] >= clear:
                return place
        raise ValueError(
            f"no place in this map is {clear} m from every point: fewer obstacles, or a smaller clear"
        )

    start, goal = clear_place(0.0, 1 / 7), clear_place(6 / 7, 1.0)
    return Map(name, PointCloud.of(points, f"map {name!r}"), np.zeros(3), size, start, goal)


def _steps(length: float, spacing: float) -> np.ndarray:
    return np.linspace(0.0, 1.0, max(2, int(np.ceil(length / spacing)) + 1))


def _rectangle(corner: Point, first: Point, second: Point, spacing: float) -> Points:
    """Points on the parallelogram that two edges span."""
    u, v = (_steps(float(np.linalg.norm(edge)), spacing) for edge in (first, second))
    return corner + (u[:, None, None] * first + v[None, :, None] * second).reshape(-1, 3)


def _block(corner: Point, shape: Point, spacing: float) -> Points:
    """Points on the six faces of a box."""
    edges = np.diag(shape)
    sides = [
        _rectangle(corner + far * edges[axis], edges[axis - 1], edges[axis - 2], spacing)
        for axis, far in product(range(3), (0.0, 1.0))
    ]
    return np.concatenate(sides)


def _wall(axis: int, at: float, begin: float, length: float, height: float, spacing: float) -> Points:
    """Points on an upright wall across one horizontal axis."""
    corner, edge = np.zeros(3), np.zeros(3)
    corner[axis], corner[1 - axis], edge[1 - axis] = at, begin, length
    return _rectangle(corner, edge, np.array([0.0, 0.0, height]), spacing)


def _tube(foot: Point, top: Point, low_radius: float, high_radius: float, spacing: float) -> Points:
    """Points on rings from foot to top, level as tree rings are."""
    share = _steps(float(np.linalg.norm(top - foot)), spacing)
    angle = np.arange(0.0, 2 * np.pi, spacing / max(low_radius, high_radius, spacing))
    radius = low_radius + share * (high_radius - low_radius)
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    return (foot + share[:, None, None] * (top - foot) + radius[:, None, None] * ring).reshape(-1, 3)


def _ball(centre: Point, radius: float, spacing: float) -> Points:
    """Points on a sphere along a golden spiral."""
    count = int(np.ceil(4 * np.pi * radius**2 / spacing**2))
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(count)
    level = np.sqrt(1.0 - z * z)
    return centre + radius * np.stack([level * np.cos(angle), level * np.sin(angle), z], axis=1)


def _gradient_noise(
    rng: np.random.Generator, places: Float[np.ndarray, "x y z 3"]
) -> Float[np.ndarray, "x y z"]:
    """Perlin's gradient noise (Perlin 2002, "Improving noise") with one lattice cell a unit."""
    cell = np.floor(places).astype(int)
    within = places - cell
    gradients = rng.normal(size=(*(cell.reshape(-1, 3).max(axis=0) + 2), 3))
    gradients /= np.linalg.norm(gradients, axis=-1, keepdims=True)
    smooth = within**3 * (within * (within * 6.0 - 15.0) + 10.0)
    total = np.zeros(places.shape[:-1])
    for corner in product((0, 1), repeat=3):
        offset = np.array(corner)
        gradient = gradients[tuple(np.moveaxis(cell + offset, -1, 0))]
        weight = np.prod(np.where(offset == 1, smooth, 1.0 - smooth), axis=-1)
        total += weight * np.sum(gradient * (within - offset), axis=-1)
    return total


def _surface(solid: Bool[np.ndarray, "x y z"]) -> Bool[np.ndarray, "x y z"]:
    """Solid voxels with a free one beside them."""
    padded = np.pad(solid, 1, constant_values=True)
    hidden = solid.copy()
    for axis, step in product(range(3), (-1, 1)):
        hidden &= np.roll(padded, step, axis)[1:-1, 1:-1, 1:-1]
    return solid & ~hidden


def _doors(rng: np.random.Generator, rooms: int) -> set[tuple[int, int, int]]:
    """Walls with a door, as (axis, line, cell): enough to join all rooms, and a third of the rest."""
    walls = [(axis, line, cell) for axis, line, cell in product((0, 1), range(1, rooms), range(rooms))]
    group = {room: room for room in product(range(rooms), repeat=2)}
    doors = set()
    for index in rng.permutation(len(walls)):
        axis, line, cell = walls[index]
        first, second = ((line - 1, cell), (line, cell)) if axis == 0 else ((cell, line - 1), (cell, line))
        joined = group[first] == group[second]
        if not joined or rng.uniform() < 1 / 3:
            doors.add(walls[index])
        if not joined:
            old, new = group[second], group[first]
            group = {room: new if name == old else name for room, name in group.items()}
    return doors
