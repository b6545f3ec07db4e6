"""Corridors from point clouds: safety, connection, size and construction time.

Run ``python -m benchmarks.corridors``. ``--json`` prints the same figures as JSON. ``--maps`` sets the number of random
maps of the four kinds, from number ``--first`` on: several processes can share them. ``--real`` names a folder with
further clouds and meshes. ``--batch`` sets how many corridors are planned at once. ``--maps-at-once`` sets how many
maps are timed at once on the default device of JAX. The last two are for a GPU.
"""

import argparse
import dataclasses
import json
import os
import sys
import time
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, ScalarLike
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial import KDTree

from jaxscp import LandingScenario, Planner, at_rest, status_names
from jaxscp.corridor import (
    CorridorResult,
    Decomposition,
    EllipsoidDecomposition,
    InflationFIRI,
    NoRoute,
    Polytope,
    build_corridor,
    chain,
    find_route,
    pad,
    read_cloud,
    synthetic_maps,
)
from jaxscp.corridor.cells import cells_along, consecutive_overlaps
from jaxscp.corridor.decompose import Seed
from jaxscp.corridor.ellipsoids import Columns, around_segment
from jaxscp.corridor.halfspaces import Cuts, Keep, cut_away
from jaxscp.corridor.route import legs
from jaxscp.corridor.shapes import needed_faces, volume
from jaxscp.landing.scenarios import through

RADIUS = 0.25
CLEARANCE = 0.1
NODES = 30
ROUNDING = 1e-9
ALLOWED = 1e-3  # m, of the certificate
SAMPLED = (
    0.15  # m: surfaces are sampled every 0.2 m or finer, so that a path through one comes so near to a point
)


class TangentShrinking(EllipsoidDecomposition):
    """The published ellipsoid decomposition: tangent planes moved by the radius, which can cut the leg."""

    def separate(
        self,
        seed: Seed,
        points: Columns,
        active: Bool[Array, "points"],
        radius: ScalarLike,
        clearance: ScalarLike,
        walls: Polytope,
    ) -> Cuts:
        """See ``Decomposition.separate``."""
        metric = around_segment(points, active, jnp.maximum(seed.half, 1e-3))
        return cut_away(
            points,
            active,
            metric,
            seed.half,
            Keep(radius, clearance),
            self.planes,
            lambda tangent, *_: tangent,
        )


METHODS: dict[str, Decomposition] = {
    "ellipsoid": EllipsoidDecomposition(),
    "capsule": EllipsoidDecomposition(capsule=True),
    "firi": InflationFIRI(),
}
REFERENCE = TangentShrinking()


def random_maps(count: int, first: int = 0) -> Iterator[synthetic_maps.Map]:
    kinds = list(synthetic_maps.KINDS.values())
    for seed in range(first, first + count):
        place = kinds[seed % len(kinds)](seed // len(kinds))
        yield dataclasses.replace(place, name=f"{place.name} {seed // len(kinds)}")


def real_maps(folder: Path, pairs: int = 12) -> Iterator[synthetic_maps.Map]:
    """Every cloud and mesh of a folder, with pairs of clear positions at flying height, drawn from a seed."""
    for path in sorted(folder.glob("*")):
        if path.suffix.lower() not in (".pcd", ".ply", ".xyz", ".npy", ".stl", ".obj"):
            continue
        cloud = read_cloud(path)
        low, high = cloud.extent
        tree = KDTree(cloud.points)
        rng = np.random.default_rng(0)
        places = rng.uniform(low, np.minimum(high, [np.inf, np.inf, low[2] + 4.0]), size=(2000, 3))
        clear = places[np.asarray(tree.query(places)[0]) > 0.6]
        for pair in range(pairs):
            yield synthetic_maps.Map(path.name, cloud, low, high, clear[2 * pair], clear[2 * pair + 1])


def points_inside(result: CorridorResult, place: synthetic_maps.Map) -> int:
    """Number of points of the given cloud strictly inside a polytope."""
    assert result.corridor is not None
    cells = zip(result.corridor.normals, result.corridor.offsets, strict=True)
    return sum(int(place.cloud.inside(Polytope(n, b), margin=-ROUNDING).sum()) for n, b in cells)


def seeds_outside(result: CorridorResult) -> int:
    """Number of polytopes that do not contain their own leg."""
    assert result.corridor is not None
    normals, offsets = np.asarray(result.corridor.normals), np.asarray(result.corridor.offsets)
    gaps = offsets[:, None, :] - np.einsum("kfc,kvc->kvf", normals, result.seeds)
    return int(np.sum(gaps.min(axis=(1, 2)) < -ROUNDING))


def corridor_of(place: synthetic_maps.Map) -> CorridorResult:
    """The corridor of a map by the default method."""
    limits = {"lower": place.lower, "upper": place.upper}
    return build_corridor(place.cloud, place.start, place.goal, RADIUS, clearance=CLEARANCE, **limits)


def safety(places: list[synthetic_maps.Map], batch_size: int) -> dict:
    """Figures of corridors by the default method, one for each map, checked against the given cloud.

    Also plans through the corridors, ``batch_size`` at once (0: no plans).
    """
    found = narrow = unresolved = no_route = crashed = inside = cut = polytopes = doubted = 0
    least, reasons, warned = np.inf, [], 0
    flights: list[tuple[synthetic_maps.Map, LandingScenario]] = []
    for number, place in enumerate(places):
        if number % 25 == 0:
            print(f"{number} of {len(places)} corridors", file=sys.stderr, flush=True)
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always", UserWarning)
                result = corridor_of(place)
            warned += bool(caught)
        except Exception as error:  # a crash counts as a result of this benchmark
            crashed += 1
            reasons.append(f"{place.name}: {type(error).__name__}: {error}")
            continue
        if isinstance(result.route, NoRoute):
            no_route += 1
            continue
        found += result.found
        narrow += "narrow" in result.message
        unresolved += "unresolved" in result.message
        if not result.found:
            reasons.append(f"{place.name}: {result.message}")
        inside += points_inside(result, place)
        cut += seeds_outside(result)
        polytopes += len(result.seeds)
        if len(result.overlaps):
            least = min(least, float(result.overlaps.min()))
        if result.found and result.corridor is not None:
            ends = at_rest(place.start), at_rest(place.goal)
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always", UserWarning)
                flight = through(result.corridor, *ends, near_obstacles=result.near_obstacles)
            doubted += bool(caught)
            flights.append((place, flight))
    solvable = len(places) - no_route
    report = {
        "maps": len(places),
        "no_route": no_route,
        "solvable": solvable,
        "solved_fraction": found / solvable,
        "narrow": narrow,
        "unresolved": unresolved,
        "crashed": crashed,
        "warned": warned,
        "doubted": doubted,
        "polytopes": polytopes,
        "points_inside": inside,
        "seeds_outside": cut,
        "min_overlap_m": least,
        "reasons": reasons,
    }
    if not (batch_size and flights):
        return report
    plans = planned(flights, batch_size)
    statuses = dict(Counter(plan.status for plan in plans))
    good = [plan for plan in plans if plan.status == "converged"]
    report["planned_fraction"] = len(good) / solvable
    report["min_distance_m"] = min((plan.distance for plan in good), default=np.nan)
    report["min_clearance_m"] = min((plan.clearance for plan in good), default=np.nan)
    report["nearer_than_radius"] = sum(plan.distance < RADIUS - ALLOWED for plan in good)
    report["through_a_surface"] = sum(plan.distance <= SAMPLED for plan in good)
    report["not_converged"] = [f"{plan.name}: {plan.status}" for plan in plans if plan.status != "converged"]
    return report | {"plans": statuses}


class Plan(NamedTuple):
    """A plan through a map, judged by the map's own points."""

    name: str
    status: str
    distance: float
    """m, from the vehicle's centre to the nearest point."""
    clearance: float
    """m, of the certificate: from the hull to the nearest known point."""


def planned(flights: list[tuple[synthetic_maps.Map, LandingScenario]], batch_size: int) -> list[Plan]:
    """Plans by the default planner, corridors and obstacles padded to one shape."""
    scenarios = [scenario for _, scenario in flights]
    count = max(s.corridor.count for s in scenarios)
    faces = max(s.corridor.offsets.shape[1] for s in scenarios)
    most = max(s.near_obstacles.points.shape[0] for s in scenarios if s.near_obstacles is not None)
    padded = [
        dataclasses.replace(
            s,
            corridor=pad(s.corridor, s.goal.position, count, faces),
            near_obstacles=_padded(s.near_obstacles, most),
        )
        for s in scenarios
    ]
    plan = jax.vmap(Planner(nodes=NODES))
    plans: list[Plan] = []
    for first in range(0, len(padded), batch_size):
        batch = [padded[min(first + k, len(padded) - 1)] for k in range(batch_size)]
        solution = plan(jax.tree.map(lambda *leaves: jnp.stack(leaves), *batch))
        names, clear = status_names(solution.status), np.asarray(solution.certificate.clearance)
        for row, (place, _) in enumerate(flights[first : first + batch_size]):
            distance = distance_to_points(place, jax.tree.map(lambda leaf, row=row: leaf[row], solution))
            plans.append(Plan(place.name, str(names[row]), distance, float(clear[row])))
        if (first // batch_size) % 25 == 0:
            print(f"{len(plans)} of {len(padded)} plans", file=sys.stderr, flush=True)
    return plans


def _padded(obstacles: Any, count: int) -> Any:
    """Obstacles with so many rows."""
    more = count - len(obstacles.present)
    rows = {"points": np.pad(np.asarray(obstacles.points), ((0, more), (0, 0)))}
    rows |= {name: np.pad(np.asarray(getattr(obstacles, name)), (0, more)) for name in ("present", "deck")}
    return dataclasses.replace(obstacles, **{name: jnp.asarray(value) for name, value in rows.items()})


def distance_to_points(place: synthetic_maps.Map, solution: Any) -> float:
    """Least distance in metres of the vehicle's centre to the points of a map, on cubics between the nodes."""
    path = solution.trajectory
    time, state = np.asarray(path.time), np.asarray(path.state)
    if not np.isfinite(state).all() or np.any(np.diff(time) <= 0.0):
        return np.nan
    cubics = CubicHermiteSpline(time, state[:, :3], state[:, 3:6])
    ways = cubics(np.interp(np.linspace(0.0, len(time) - 1.0, 20 * len(time)), np.arange(len(time)), time))
    return float(np.min(KDTree(place.cloud.points).query(ways)[0]))


def sizes(places: list[synthetic_maps.Map]) -> dict:
    """Volume and number of faces by method, on the same legs, with the published method for comparison."""
    volumes: dict[str, list[float]] = {name: [] for name in ("published", *METHODS)}
    faces: dict[str, list[int]] = {name: [] for name in volumes}
    cut = 0
    for place in places:
        result = corridor_of(place)
        if isinstance(result.route, NoRoute):
            continue
        segments = legs(result.route.points, 6.0)
        cloud = place.cloud.thinned(0.1)
        for name in volumes:
            method = METHODS.get(name, REFERENCE)
            cells = cells_along(method, segments, cloud, RADIUS, CLEARANCE, place.lower, place.upper).polytope
            normals, offsets = np.asarray(cells.normals), np.asarray(cells.offsets)
            for n, b, segment in zip(normals, offsets, segments, strict=True):
                cell = Polytope(jnp.asarray(n), jnp.asarray(b))
                volumes[name].append(volume(cell))
                faces[name].append(len(needed_faces(cell, segment.mean(axis=0))))
                cut += name == "published" and np.min(b - segment @ n.T) < -ROUNDING
    base = np.array(volumes["published"])
    usable = base > 0
    return {
        "legs": len(base),
        "published_cuts_its_leg": int(cut),
        "volume_ratio": {
            name: float(np.exp(np.mean(np.log(np.array(v)[usable] / base[usable]))))
            for name, v in volumes.items()
        },
        "median_volume_m3": {name: float(np.median(v)) for name, v in volumes.items()},
        "mean_faces": {name: float(np.mean(f)) for name, f in faces.items()},
    }


def twelve_legs(points: int = 50_000):
    """A forest with the given number of points, and a route of twelve legs through this forest."""
    place = synthetic_maps.forest(7, spacing=0.1)
    rng = np.random.default_rng(0)
    cloud = place.cloud.thinned(0.05)
    chosen = np.sort(rng.choice(cloud.count, points, replace=False))
    cloud = type(cloud)(cloud.points[chosen], cloud.spread)
    result = build_corridor(
        cloud, place.start, place.goal, RADIUS, lower=place.lower, upper=place.upper, voxel=None
    )
    assert not isinstance(result.route, NoRoute)
    longest = result.route.length
    while len(segments := legs(result.route.points, longest)) < 12:
        longest *= 0.98
    return place, cloud, segments[:12]


def milliseconds(repeats: int = 30) -> dict:
    """Median warm times, ms, from 50 000 points and twelve legs to twelve polytopes and their overlaps."""
    place, cloud, segments = twelve_legs()
    overlaps = jax.jit(consecutive_overlaps)
    report = {}
    for name, method in METHODS.items():
        cells, whole = [], []
        for repeat in range(repeats + 3):
            begin = time.perf_counter()
            made = cells_along(method, segments, cloud, RADIUS, CLEARANCE, place.lower, place.upper)
            middle = time.perf_counter()
            jax.block_until_ready(overlaps(jax.tree.map(jnp.asarray, made.polytope)))
            if repeat >= 3:
                cells.append(middle - begin)
                whole.append(time.perf_counter() - begin)
        report[name] = {
            "cells": 1e3 * float(np.median(cells)),
            "with_overlaps": 1e3 * float(np.median(whole)),
        }
    return report


def batched(count: int, repeats: int = 5) -> dict:
    """Time, ms, for a chain of eight polytopes in each map of a batch, on the default device."""
    places = [synthetic_maps.pillars(seed) for seed in range(count)]
    most = max(place.cloud.count for place in places)
    points = np.zeros((count, most, 3))
    present = np.zeros((count, most), bool)
    ways = np.zeros((count, 9, 3))
    for row, place in enumerate(places):
        points[row, : place.cloud.count] = place.cloud.points
        present[row, : place.cloud.count] = True
        ways[row] = _eight_legs(place)
    report: dict = {"device": str(jax.devices()[0].device_kind), "maps": count, "points_each": most}
    arrays = jax.device_put((ways, points, present))
    for name, method in METHODS.items():

        def one(way, cloud, there, method=method):
            return chain(method, way, cloud, there, RADIUS, CLEARANCE)

        run = jax.jit(jax.vmap(one))
        made = jax.block_until_ready(run(*arrays))
        begin = time.perf_counter()
        for _ in range(repeats):
            jax.block_until_ready(run(*arrays))
        report[name] = {
            "ms": 1e3 * (time.perf_counter() - begin) / repeats,
            "unresolved": int(np.sum(np.asarray(made.left) > 0)),
            "min_overlap_m": float(np.min(np.asarray(made.overlaps))),
        }
    return report


def _eight_legs(place: synthetic_maps.Map) -> np.ndarray:
    """The first eight legs of the route; the longest leg is halved until there are eight."""
    route = find_route(place.cloud, place.start, place.goal, RADIUS, lower=place.lower, upper=place.upper)
    points = list(np.stack([place.start, place.goal]) if isinstance(route, NoRoute) else route.points)
    while len(points) < 9:
        longest = int(np.argmax(np.linalg.norm(np.diff(points, axis=0), axis=1)))
        points.insert(longest + 1, 0.5 * (points[longest] + points[longest + 1]))
    return np.array(points[:9])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--maps", type=int, default=500, help="random maps in the check of safety")
    parser.add_argument("--first", type=int, default=0, help="number of the first of these maps")
    parser.add_argument("--sized", type=int, default=40, help="random maps in the comparison of volumes")
    parser.add_argument("--batch", type=int, default=1, help="corridors planned through at once; 0: none")
    parser.add_argument("--maps-at-once", type=int, default=0, help="maps to build corridors in at once")
    folder = os.environ.get("JAXSCP_MAPS")
    parser.add_argument(
        "--real", type=Path, default=folder, help="folder of real clouds and meshes; default: $JAXSCP_MAPS"
    )
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    warnings.simplefilter("ignore")

    report = {}
    if options.maps:
        report["safety"] = safety(list(random_maps(options.maps, options.first)), options.batch)
    if options.sized:
        report["sizes"] = sizes(list(random_maps(options.sized)))
        report["ms_12_polytopes"] = milliseconds()
    real = list(real_maps(options.real)) if options.real and options.real.is_dir() else []
    if real:
        report["real"] = safety(real, options.batch)
    if options.maps_at_once:
        report["batched"] = batched(options.maps_at_once)
    if options.json:
        print(json.dumps(report))
    else:
        _show(report)


def _show(report: dict, indent: str = "") -> None:
    for name, value in report.items():
        if isinstance(value, dict):
            print(f"{indent}{name}")
            _show(value, indent + "    ")
        elif isinstance(value, list):
            for line in value:
                print(f"{indent}{name}: {line}")
        else:
            print(
                f"{indent}{name:<24} {value:.4g}"
                if isinstance(value, float)
                else f"{indent}{name:<24} {value}"
            )


if __name__ == "__main__":
    main()
