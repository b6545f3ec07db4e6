"""A hall with a wall across it, as points and as a mesh, and an oracle that knows its solid parts."""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import linprog

START, GOAL = np.array([0.0, -1.5, 1.5]), np.array([6.0, -1.5, 1.2])
WALL = ((2.9, -3.0, 0.0), (3.1, 1.6, 3.0))
SOLID = [
    WALL,
    ((-1.2, -3.2, -9.0), (7.2, 3.2, 0.0)),
    ((-1.2, -3.2, 3.0), (7.2, 3.2, 9.0)),
    ((-1.2, -3.2, 0.0), (-1.0, 3.2, 3.0)),
    ((7.0, -3.2, 0.0), (7.2, 3.2, 3.0)),
    ((-1.0, -3.2, 0.0), (7.0, -3.0, 3.0)),
    ((-1.0, 3.0, 0.0), (7.0, 3.2, 3.0)),
]
FOLDER = Path(os.environ.get("JAXSCP_CASES", Path(__file__).parents[3] / "shared" / "cases"))


def faces_of(lower, upper):
    """Six quadrilaterals of a box, (6, 4, 3)."""
    low, high = np.array(lower), np.array(upper)
    out = []
    for axis in range(3):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        for value in (low[axis], high[axis]):
            quad = np.zeros((4, 3))
            quad[:, axis] = value
            quad[:, a] = [low[a], high[a], high[a], low[a]]
            quad[:, b] = [low[b], low[b], high[b], high[b]]
            out.append(quad)
    return np.array(out)


def quads():
    """Surfaces of the hall: its six sides, and the wall."""
    return np.concatenate([faces_of((-1, -3, 0), (7, 3, 3)), faces_of(*WALL)])


def hall_points(spacing=0.2):
    """Points on every surface of the hall, on grids of a spacing."""
    parts = []
    for corner, first, _, last in quads():
        u, v = first - corner, last - corner
        counts = [round(np.linalg.norm(edge) / spacing) + 1 for edge in (u, v)]
        a, b = np.meshgrid(*(np.linspace(0, 1, max(count, 2)) for count in counts), indexing="ij")
        parts.append(corner + a.reshape(-1, 1) * u + b.reshape(-1, 1) * v)
    return np.unique(np.round(np.concatenate(parts), 9), axis=0)


def depth_in_solid(corridor):
    """Radius of the largest ball that a corridor and a solid part of the hall share, metres; negative if none."""
    worst = -np.inf
    for normals, offsets in zip(np.asarray(corridor.normals), np.asarray(corridor.offsets), strict=True):
        used = np.any(normals != 0, axis=1)
        for low, high in SOLID:
            rows = np.concatenate([normals[used], np.eye(3), -np.eye(3)])
            right = np.concatenate([offsets[used], high, -np.array(low)])
            found = linprog(
                [0, 0, 0, -1], np.column_stack([rows, np.ones(len(rows))]), right, bounds=[(None, None)] * 4
            )
            worst = max(worst, found.x[3])
    return worst


@pytest.fixture
def hall():
    """Points of the hall every 0.2 m."""
    return hall_points()


@pytest.fixture
def case():
    """Path of a file of the folder of cases; the test is skipped where it is absent."""

    def path(name):
        file = FOLDER / name
        if not file.is_file():
            pytest.skip(f"no {name} in {FOLDER}: set JAXSCP_CASES to the folder of cases")
        return file

    return path
