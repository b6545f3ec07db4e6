"""A map judged as a map, before anyone flies through it: units, extent, spacing, place and frame."""

from collections.abc import Iterator
from dataclasses import replace

import equinox as eqx
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from jaxscp.corridor.clouds import PointCloud
from jaxscp.corridor.columns import COUNTED, counts_points
from jaxscp.corridor.extent import Triple, main_box, within
from jaxscp.corridor.map_flight import Flight
from jaxscp.corridor.spacing import typical_spacing

_NEAR = 5.0
_BELOW = 0.05
_OUTSIDE = 0.5
_TALL = 1.5
_LEVEL = 1e-6
_SAMPLES = 9
_FEW = 40


class MapError(ValueError):
    """A map that no plan may trust; the message names the file, the cause and the option that exists."""


class MapReport(eqx.Module):
    """Facts about a map, and whether it may be planned in."""

    source: str
    """File that the map came from."""
    points: int
    """Number of points."""
    dropped: int
    """Points of the file that were not usable."""
    strays: int
    """Points far from all others, which do not widen the box."""
    lower: Float[np.ndarray, "3"]
    """Lower corner of the map's box, metres."""
    upper: Float[np.ndarray, "3"]
    """Upper corner of the map's box, metres."""
    spacing: float
    """Median distance between neighbouring points, metres."""
    radius: float | None = None
    """Safety radius that the spacing is compared with, metres."""
    inside: tuple[bool, bool] | None = None
    """Whether start and goal lie in the map's box."""
    assumed: tuple[str, ...] = ()
    """Assumptions: facts that neither the file nor the caller stated."""
    warnings: tuple[str, ...] = ()
    """Doubts that do not prevent a plan."""
    refused: tuple[str, ...] = ()
    """Reasons why no plan may be made."""

    @property
    def accepted(self) -> bool:
        """Whether a plan may be made."""
        return not self.refused

    def __str__(self) -> str:
        """The report in lines, as the command line prints it."""
        size = " x ".join(f"{length:.4g}" for length in self.upper - self.lower)
        lines = [
            f"map {self.source}: {self.points} points, {self.dropped} dropped, {self.strays} stray",
            f"box {_place(self.lower)} to {_place(self.upper)} m, {size} m",
            f"neighbouring points {self.spacing:.3g} m from each other"
            + (f", safety radius {self.radius:.3g} m" if self.radius is not None else ""),
        ]
        if self.inside is not None:
            lines.append(
                ", ".join(
                    f"{n} {'in' if i else 'outside'} the box"
                    for n, i in zip(("start", "goal"), self.inside, strict=True)
                )
            )
        for heading, entries in (
            ("assumed", self.assumed),
            ("warning", self.warnings),
            ("refused", self.refused),
        ):
            lines += [f"{heading}: {entry}" for entry in entries]
        return "\n".join(lines)


def _empty(cloud: PointCloud) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Warnings and refusals of a cloud without points; an empty array is free space."""
    what = f"none of its {cloud.dropped} points is finite" if cloud.dropped else "it holds no point"
    words = (f"{what}, so that no obstacle is known",)
    return ((), words) if cloud.dropped or cloud.file is not None else (words, ())


def map_report(
    cloud: PointCloud | ArrayLike,
    start: Triple | None = None,
    goal: Triple | None = None,
    radius: float = 0.25,
    *,
    lower: Triple | None = None,
    upper: Triple | None = None,
) -> MapReport:
    """Judge a map for a flight: units, spacing, place and frame.

    A map whose unit or frame nobody stated is refused where its points contradict metres or z up. An array of a few
    points, or with both limits, is warned of instead. Without start and goal, frame and place are not judged.

    Args:
        cloud: the map, or its points as an array, (points, 3), metres.
        start: (3,) start of the flight, metres; None judges the map alone.
        goal: (3,) its goal, metres; None judges the map alone.
        radius: safety radius of the vehicle, metres.
        lower: (3,) lower corner that the caller states for the vehicle's centre, metres.
        upper: (3,) upper corner that the caller states, metres.

    Example:
        >>> ground = PointCloud.of([[0.2 * x, 0.2 * y, 0.0] for x in range(50) for y in range(50)])
        >>> report = map_report(ground, [1, 1, 1], [8, 8, 1])
        >>> report.accepted, round(report.spacing, 3), report.inside
        (True, 0.2, (False, False))
    """
    cloud = PointCloud.at(cloud)
    source = cloud.file or "array"
    if cloud.count == 0:
        nowhere = np.zeros(3), np.zeros(3), np.inf
        return MapReport(source, 0, cloud.dropped, 0, *nowhere, radius, None, (), *_empty(cloud))
    facts = _facts(cloud, source, radius)
    flight, inside = None, None
    if start is not None and goal is not None:
        corners = [None if corner is None else np.asarray(corner, float) for corner in (lower, upper)]
        flight = Flight(np.asarray(start, float), np.asarray(goal, float), radius, *corners)
        first, last = within(flight.ends, facts.lower, facts.upper).tolist()
        inside = (first, last)
    # A few points are single obstacles, and both limits state where the flight is.
    lenient = cloud.file is None and (cloud.count <= _FEW or not (lower is None or upper is None))
    findings = list(_findings(facts, cloud, flight, severe=not lenient))
    return replace(
        facts,
        inside=inside,
        warnings=tuple(text for severe, text in findings if not severe),
        refused=tuple(text for severe, text in findings if severe),
    )


def _facts(cloud: PointCloud, source: str, radius: float) -> MapReport:
    """Facts about a map alone; nothing is judged."""
    box = main_box(cloud.points)
    counts = cloud.count, cloud.dropped, box.strays
    assumed = _assumed(cloud, box.strays)
    return MapReport(
        source, *counts, box.lower, box.upper, typical_spacing(cloud.points), radius, assumed=assumed
    )


def _assumed(cloud: PointCloud, strays: int) -> tuple[str, ...]:
    origin = cloud.provenance
    notes = [] if origin is None else list(origin.notes)
    if origin is not None and origin.unit is None:
        notes.append("unit m")
    if origin is not None and origin.frame is None:
        notes.append("z up")
    if strays:
        notes.append(f"{strays} stray points do not widen the map's box")
    return tuple(notes)


def _findings(
    facts: MapReport, cloud: PointCloud, flight: Flight | None, severe: bool
) -> Iterator[tuple[bool, str]]:
    """Findings about a map and a flight, if there is one, each with whether it prevents a plan."""
    origin, of_file = cloud.provenance, cloud.file is not None
    if origin is not None:
        yield from ((True, doubt) for doubt in origin.doubts)
    if cloud.count >= COUNTED and counts_points(cloud.points[:, 0]):
        yield (
            True,
            f"x counts the points, {cloud.points[0, 0]:g}, {cloud.points[1, 0]:g}, ...: a number rather than x?",
        )
    stated = origin is not None and origin.unit is not None
    length = None if flight is None else flight.length
    yield from _unit_findings(facts, length, of_file=of_file, stated=stated, severe=severe)
    if flight is None:
        return
    yield from _place_findings(facts, flight, of_file=of_file, severe=severe)
    if (origin is None or origin.frame is None) and _upside_down(facts, cloud, flight):
        yield (
            severe,
            f"start and goal lie above the map, at z = {flight.start[2]:g} and {flight.goal[2]:g} m, and in it "
            f"if z points down: z of the map runs from {facts.lower[2]:g} to {facts.upper[2]:g} m. State the frame: "
            "frame='ned', 'frd' or 'enu' (--frame), of an array in PointCloud.of",
        )
    if flight.lower is not None and flight.upper is not None:
        low, high = flight.lower - flight.radius, flight.upper + flight.radius
        if not within(cloud.points, low, high).any():
            yield (
                severe,
                f"none of its {facts.points} points lies within the limits {_place(flight.lower)} to "
                f"{_place(flight.upper)} m: the map is elsewhere, or its unit or offset is another one",
            )


def _unit_findings(
    facts: MapReport, length: float | None, of_file: bool, stated: bool, severe: bool
) -> Iterator[tuple[bool, str]]:
    radius = facts.radius or 0.0
    extent = float((facts.upper - facts.lower).max())
    if facts.points > 1 and extent == 0.0:
        yield severe, f"all of its {facts.points} points lie at {_place(facts.lower)} m"
    elif facts.points > 1 and extent < 2.0 * radius and facts.points > _FEW:
        yield (
            severe and not stated,
            f"the whole map is {extent:.3g} m wide, less than a vehicle of radius {radius:g} m. State its unit: "
            "unit='km' say (--unit km), of an array in PointCloud.of",
        )
    few = 1 if of_file else _FEW
    wide = facts.spacing > (2.0 if of_file else 20.0) * radius > 0.0
    if wide and not stated and facts.points > few and np.isfinite(facts.spacing):
        yield (
            severe,
            f"neighbouring points are {facts.spacing:.3g} m from each other, so that a vehicle of radius "
            f"{radius:g} m passes between them; the map spans {extent:.4g} m"
            f"{'' if length is None else f', the flight {length:.3g} m'}. "
            "State the unit, mm say, or m if that is right, which closes the gaps: unit='m' (--unit m), "
            "of an array in PointCloud.of",
        )


def _place_findings(
    facts: MapReport, flight: Flight, of_file: bool, severe: bool
) -> Iterator[tuple[bool, str]]:
    """Whether start and goal lie in or near the box of the map, and not below it."""
    box = f"the map's box {_place(facts.lower)} to {_place(facts.upper)} m"
    remedy = (
        "State where the local origin lies in the map, offset=(x, y, z) (--offset), its unit (--unit) or its frame "
        "(--frame)"
        if of_file
        else "Subtract the local origin from the points, state their unit or frame in PointCloud.of, or state limits: "
        "lower= and upper= (--lower, --upper)"
    )
    sides = np.stack([facts.lower - flight.ends, flight.ends - facts.upper])
    beyond = sides.max(axis=0)
    near = max(_NEAR, float((facts.upper - facts.lower).max()))
    ends = f"start {_place(flight.start)} and goal {_place(flight.goal)}"
    if np.any(beyond.max(axis=1) > near):
        far = float(beyond.max())
        yield severe, f"{ends} do not both lie in or near {box}: {far:.4g} m outside. {remedy}"
        return
    # An end beside the map by more than the radius: nobody saw free space there, and a wrong frame looks like that.
    beside = np.any(sides[:, :, :2] > min(_OUTSIDE, flight.radius), axis=(0, 2))
    if of_file and beside.any() and (flight.lower is None or flight.upper is None):
        which = " both lie" if beside.all() else f": {('start', 'goal')[int(beside[1])]} lies"
        yield (
            True,
            f"{ends}{which} outside {box}, where nobody saw free space. {remedy}; or state limits: lower= and "
            "upper= (--lower, --upper)",
        )
        return
    below = facts.lower[2] - flight.ends[:, 2]
    reach = -np.inf if flight.lower is None else flight.lower[2]
    if np.any(below > _BELOW) and not (np.isfinite(reach) and reach <= flight.ends[:, 2].min()):
        yield (
            True,
            f"{ends}: z lies {below.max():.3g} m below the lowest point of the map, {facts.lower[2]:g} m, where "
            "nobody saw free space. State the offset (--offset) or the frame (--frame) of the map, or a limit: "
            "lower=(x, y, z) (--lower)",
        )


def _upside_down(facts: MapReport, cloud: PointCloud, flight: Flight) -> bool:
    """Whether both ends lie above the map, and in it, clear of its points, if z points down.

    Ends that stand on the map's top stand on its floor if z points down. Then the floor's points do not count.
    """
    z, top = flight.ends[:, 2], facts.upper[2]
    if np.any(z < top - _LEVEL) or np.any(-z < facts.lower[2]) or top - facts.lower[2] < _TALL:
        return False
    points = cloud.points
    if np.any(z < top + flight.radius):
        if not _joined(facts, points, flight):
            return False
        points = points[points[:, 2] < top - flight.radius]
    mirrored = flight.ends * [1.0, 1.0, -1.0]
    return min(_distance(points, end) for end in mirrored) >= flight.radius


def _joined(facts: MapReport, points: Float[np.ndarray, "points 3"], flight: Flight) -> bool:
    """Whether a surface at the map's top leads from end to end: a floor or a roof, not two decks."""
    way = np.linspace(flight.start, flight.goal, _SAMPLES)
    way[:, 2] = facts.upper[2]
    return all(_distance(points, place) <= 2.0 * max(flight.radius, facts.spacing) for place in way)


def _distance(points: Float[np.ndarray, "points 3"], place: Float[np.ndarray, "3"]) -> float:
    """Distance to the nearest point, infinite without points."""
    return float(np.sqrt(np.sum((points - place) ** 2, axis=1).min(initial=np.inf)))


def _place(corner: np.ndarray) -> str:
    return f"({', '.join(f'{value:.7g}' for value in corner)})"
