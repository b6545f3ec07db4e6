"""From a segment of a route and the points around it to one convex polytope: two methods, one interface.

A method is a value that is called with a segment and a cloud of one static size. It compiles once per size,
and ``vmap`` runs it over segments, over clouds, or over both. Every polytope has the same number of rows: the
method's planes, six of a box about the segment, six of the volume that may be flown in.
"""

# pyright: reportArgumentType=false, reportOperatorIssue=false
# jax 0.9 declares of ``where`` that it may return a tuple, for arguments whose types are not declared

from abc import abstractmethod

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, ScalarLike

from jaxscp.core.trees import tree_where
from jaxscp.core.types import Vector3
from jaxscp.corridor.ellipsoids import Columns, Ellipsoid, around_segment, inside_polytope
from jaxscp.corridor.halfspaces import Cuts, Keep, capsule_only, cut_away, switch, turn
from jaxscp.corridor.polytope import Polytope

_SHORTEST = 1e-3
"""Half length in metres below which a segment's ellipsoid is taken as if it were this long."""


class Seed(eqx.Module):
    """A segment in its own frame: x along it, z as near to up as that allows, origin in the middle."""

    axes: Float[Array, "3 3"]
    """Rows are the frame's axes in the world."""
    middle: Vector3
    """Middle of the segment in the world, metres."""
    half: Float[Array, ""]
    """Half its length, metres."""


class Cell(eqx.Module):
    """One polytope of a corridor, and whether the method finished it."""

    polytope: Polytope
    """Half-spaces in the world, padded with rows 0 . p <= 1."""
    left: Int[Array, ""]
    """Points that the method's planes did not cut away; zero when the cell may be used."""


def seed_of(segment: Float[Array, "2 3"]) -> Seed:
    """Frame of a segment; one without length lies along the world's x axis.

    Example:
        >>> import jax.numpy as jnp
        >>> float(seed_of(jnp.array([[0.0, 0.0, 1.0], [0.0, 6.0, 1.0]])).half)
        3.0
    """
    start, end = segment
    along = end - start
    length = jnp.linalg.norm(along)
    x = jnp.where(length > 0, along / jnp.where(length > 0, length, 1.0), jnp.array([1.0, 0, 0], along.dtype))
    steep = jnp.abs(x[2]) > 0.9
    up = jnp.where(steep, jnp.array([0, 1.0, 0], along.dtype), jnp.array([0, 0, 1.0], along.dtype))
    y = jnp.cross(up, x)
    y = y / jnp.linalg.norm(y)
    return Seed(jnp.stack([x, y, jnp.cross(x, y)]), 0.5 * (start + end), 0.5 * length)


class Decomposition(eqx.Module):
    """What every method has: slots for planes, and how far from the segment it looks.

    ``method(segment, points, present, radius, clearance, lower, upper)`` returns a ``Cell``.
    """

    planes: int = eqx.field(static=True, default=24)
    """Slots for separating planes. More are needed only in dense clutter: ``Cell.left`` tells."""
    reach: float = 2.0
    """How far the box about the segment extends beyond it on every side, metres."""

    @abstractmethod
    def separate(
        self,
        seed: Seed,
        points: Columns,
        active: Bool[Array, "points"],
        radius: ScalarLike,
        clearance: ScalarLike,
        walls: Polytope,
    ) -> Cuts:
        """Planes between the seed and the points, in the seed's frame; ``walls`` bound the cell besides."""

    @property
    def rows(self) -> int:
        """Rows of every polytope."""
        return self.planes + 12

    def __call__(
        self,
        segment: Float[Array, "2 3"],
        points: Float[Array, "points 3"],
        present: Bool[Array, "points"],
        radius: ScalarLike,
        clearance: ScalarLike = 0.1,
        lower: Vector3 | None = None,
        upper: Vector3 | None = None,
    ) -> Cell:
        """Polytope around a segment that keeps ``radius`` from every point.

        The cell holds the segment if the points keep ``radius`` from it. If they keep ``radius + clearance``, it
        holds a capsule of radius ``clearance`` about it: two cells whose segments share such an end then overlap in
        a ball of that radius.

        Args:
            segment: (2, 3) its ends, metres.
            points: (points, 3) obstacle points, metres; far ones cost time but change nothing.
            present: (points,) False where a row only pads the array.
            radius: safety radius of the vehicle, metres.
            clearance: radius to leave free around the segment, metres.
            lower: (3,) lower corner of the volume the vehicle's centre may use; -inf or None: no limit.
            upper: (3,) its upper corner; inf or None: no limit.

        Example:
            >>> import jax.numpy as jnp
            >>> segment = jnp.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0]])
            >>> wall = jnp.array([[2.0, 1.0, 0.0]])
            >>> cell = EllipsoidDecomposition()(segment, wall, jnp.array([True]), 0.25)
            >>> round(float(cell.polytope.offsets[0]), 6), int(cell.left)
            (0.75, 0)
        """
        # Some accelerators multiply float32 matrices with ten bits: too few to tell a point's side.
        with jax.default_matmul_precision("highest"):
            return self._cell(segment, points, present, radius, clearance, lower, upper)

    def _cell(self, segment, points, present, radius, clearance, lower, upper) -> Cell:
        dtype = segment.dtype
        lower = jnp.full(3, -jnp.inf, dtype) if lower is None else lower
        upper = jnp.full(3, jnp.inf, dtype) if upper is None else upper
        seed = seed_of(segment)
        # Beyond the walls by more than the radius, a point has no say.
        flyable = jnp.all((points >= lower - radius) & (points <= upper + radius), axis=1)
        local = seed.axes @ (points - seed.middle).T
        extent = jnp.array([1.0, 0, 0], dtype) * seed.half + self.reach
        near = jnp.all(jnp.abs(local) <= (extent + radius)[:, None], axis=0)
        walls = _walls(seed, extent, lower, upper)
        cuts = self.separate(seed, local, present & near & flyable, radius, clearance, walls)
        normals = jnp.concatenate([cuts.normals, walls.normals]) @ seed.axes
        offsets = jnp.concatenate([cuts.offsets, walls.offsets]) + normals @ seed.middle
        return Cell(Polytope(normals, offsets), cuts.left)


def _walls(seed: Seed, extent: Vector3, lower: Vector3, upper: Vector3) -> Polytope:
    """The box about the segment and the limits of the volume, in the seed's frame."""
    eye = jnp.eye(3, dtype=extent.dtype)
    limits = jnp.concatenate([upper - seed.middle, seed.middle - lower])
    bounded = jnp.isfinite(limits)
    outward = jnp.concatenate([seed.axes.T, -seed.axes.T])
    return Polytope(
        jnp.concatenate([eye, -eye, jnp.where(bounded[:, None], outward, 0.0)]),
        jnp.concatenate([extent, extent, jnp.where(bounded, limits, 1.0)]),
    )


class EllipsoidDecomposition(Decomposition):
    """Ellipsoid decomposition (Liu et al. 2017, RA-L), with a shrinking that never cuts the segment.

    An ellipsoid about the segment grows until it meets a point; the tangent plane there, moved towards the
    segment by the safety radius, becomes a face. Where that would leave the segment less than ``clearance``,
    the plane normal to the closest point of the segment is taken.
    """

    capsule: bool = eqx.field(static=True, default=False)
    """Take that plane everywhere: fewer faces and wider overlaps for less volume."""

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
        metric = around_segment(points, active, jnp.maximum(seed.half, _SHORTEST))
        rule = capsule_only if self.capsule else switch
        return cut_away(points, active, metric, seed.half, Keep(radius, clearance), self.planes, rule)


class InflationFIRI(Decomposition):
    """Inflation in the manner of FIRI (Wang et al. 2024, T-RO): the seed stays inside, the volume grows.

    Rounds alternate between planes and the largest ellipsoid inside the polytope that they make. Planes are laid
    nearest to an ellipsoid first, and turned only as far as the seed demands. The first ellipsoid is the closed form
    about the segment. The round with the largest inscribed ellipsoid is taken, so more rounds never lose.
    """

    rounds: int = eqx.field(static=True, default=2)
    """Times that planes are laid."""

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

        def largest(cuts: Cuts) -> tuple[Ellipsoid, Float[Array, ""]]:
            normals = jnp.concatenate([cuts.normals, walls.normals])
            offsets = jnp.concatenate([cuts.offsets, walls.offsets])
            return inside_polytope(normals, offsets, jnp.zeros(3, points.dtype))

        def lay_again(count: Int[Array, ""], best: tuple[Ellipsoid, Cuts, Float[Array, ""]]):
            metric, cuts, volume = best
            laid = cut_away(points, active, metric, seed.half, Keep(radius, clearance), self.planes, turn)
            ellipsoid, grown = largest(laid)
            # A cell whose face touches the segment's middle has no ellipsoid: keep to the earlier one.
            ellipsoid = tree_where(jnp.isfinite(grown), ellipsoid, metric)
            better = (count == 0) | ((grown > volume) & (laid.left <= cuts.left))
            return tree_where(better, (ellipsoid, laid, grown), best)

        first = around_segment(points, active, jnp.maximum(seed.half, _SHORTEST))
        dtype = points.dtype
        nothing = Cuts(
            jnp.zeros((self.planes, 3), dtype), jnp.ones(self.planes, dtype), jnp.zeros((), jnp.int32)
        )
        begun = (first, nothing, jnp.zeros((), dtype))
        # A loop, so that a round is compiled once.
        return jax.lax.fori_loop(0, self.rounds, lay_again, begun)[1]
