"""Random places: chains of rooms with known walls, and halls with a wall across."""

import numpy as np

from benchmarks.fuzz.oracle import Box

WALLS = 0.4  # m between points of a room's walls


def chain(rng: np.random.Generator, rooms: int) -> tuple[list[Box], np.ndarray, np.ndarray]:
    """One room, or three round two corners; a start in the first and a goal in the last. m."""
    width, height = rng.uniform(1.6, 3.0), rng.uniform(2.8, 4.0)
    first, side, last = rng.uniform(width + 1.5, width + 4.0, 3)
    half = 0.5 * width
    boxes = [((0.0, -half, 0.0), (first, half, height))]
    end = np.array([first - 0.6, 0.0])
    if rooms == 3:
        reach = side - half
        boxes += [((first - width, -half, 0.0), (first, reach, height))]
        boxes += [((first - width, reach - width, 0.0), (first - width + last, reach, height))]
        end = np.array([first - width + last - 0.7, reach - half])
    start = np.array([0.6, rng.uniform(-0.2, 0.2), rng.uniform(0.6, height - 1.2)])
    goal = np.array([*end, rng.uniform(0.5, height - 1.6)])
    turn = _quarter(int(rng.integers(4)), rng.random() < 0.5)
    shift = rng.choice([0.0, 1.0, 200.0]) * rng.uniform(-1.0, 1.0, 3)
    corners = [np.sort(np.array(box) @ turn.T + shift, axis=0) for box in boxes]
    return [(c[0], c[1]) for c in corners], turn @ start + shift, turn @ goal + shift


def _quarter(turns: int, mirrored: bool) -> np.ndarray:
    matrix = np.linalg.matrix_power(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), turns)
    return matrix @ np.diag([1.0, -1.0 if mirrored else 1.0, 1.0])


def faces(low: np.ndarray, high: np.ndarray, spacing: float) -> np.ndarray:
    """Points on the six faces of a box, on grids of about a spacing."""
    axes = [np.linspace(a, b, max(2, round((b - a) / spacing) + 1)) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid[np.any((grid == low) | (grid == high), axis=1)]


def walls(boxes: list[Box], spacing: float = WALLS) -> np.ndarray:
    """Points on the walls of a union of rooms."""
    points = np.concatenate([faces(low, high, spacing) for low, high in boxes])
    inside = [np.all((points > low + 1e-9) & (points < high - 1e-9), axis=1) for low, high in boxes]
    return points[~np.any(inside, axis=0)]


def hall(rng: np.random.Generator) -> tuple[np.ndarray, list[Box], np.ndarray, np.ndarray]:
    """Points, solid boxes, start and goal: a closed hall with a wall that leaves a gap at one side. m."""
    length, half, height = rng.uniform(6.0, 9.0), rng.uniform(2.5, 3.5), rng.uniform(2.6, 3.4)
    middle, gap = 0.5 * length + rng.uniform(-0.5, 0.5), rng.uniform(1.2, 2.0)
    wall = np.array([middle - 0.1, -half, 0.0]), np.array([middle + 0.1, half - gap, height])
    low, high = np.array([0.0, -half, 0.0]), np.array([length, half, height])
    points = np.concatenate([faces(low, high, 0.2), faces(*wall, 0.2)])
    solid = [wall]
    for axis in range(3):
        for side, towards in ((low, -1.0), (high, 1.0)):
            a, b = low - 0.5, high + 0.5
            a[axis], b[axis] = sorted((side[axis], side[axis] + 9.0 * towards))
            solid.append((a, b))
    start = np.array([1.0, rng.uniform(-1, 1), rng.uniform(0.8, 1.5)])
    goal = np.array([length - 1.0, rng.uniform(-1, 1), rng.uniform(0.8, 1.5)])
    return points, solid, start, goal
