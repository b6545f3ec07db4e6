"""One convex polytope, and the overlap of two."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from jaxscp.core.arrays import namespace, triple


class Polytope(eqx.Module):
    """One convex polytope {p : normals p <= offsets}."""

    normals: Float[Array, "faces 3"]
    """Outward unit normals, (faces, 3)."""
    offsets: Float[Array, "faces"]
    """Signed distances of the faces from the origin in metres, (faces,)."""


def box(lower: ArrayLike, upper: ArrayLike) -> Polytope:
    """Axis-aligned box, by its least and its greatest corner.

    Args:
        lower: (3,) the least coordinates along x, y and z, m.
        upper: (3,) the greatest ones, m.

    Raises:
        ValueError: the box has no width along an axis, the corners are swapped along one, or are no three finite
            numbers.

    Example:
        >>> import jaxscp
        >>> jaxscp.corridor.box([0.0, 0.0, 0.0], [1.0, 2.0, 3.0]).offsets.tolist()
        [1.0, 2.0, 3.0, -0.0, -0.0, -0.0]
    """
    xp, least, most = namespace(lower, upper), triple("box: lower", lower), triple("box: upper", upper)
    if xp is np:
        for axis, low, high in zip("xyz", least, most, strict=True):
            if not (np.isfinite(low) and np.isfinite(high)):
                raise ValueError(f"box: the corners must be finite, got {low:g} and {high:g} m along {axis}")
            if low > high:
                raise ValueError(
                    f"box: lower {axis} {low:g} m exceeds upper {axis} {high:g} m; are they swapped?"
                )
            if low == high:
                raise ValueError(f"box: no width along {axis}: lower and upper are both {low:g} m")
    offsets = xp.concatenate([most, -least])
    return Polytope(jnp.asarray(np.concatenate([np.eye(3), -np.eye(3)])), jnp.asarray(offsets))


def intersect(first: Polytope, second: Polytope) -> Polytope:
    """The overlap of two polytopes: all rows of both.

    Example:
        >>> import jaxscp
        >>> room = jaxscp.corridor.box([0.0, 0.0, 0.0], [4.0, 2.0, 3.0])
        >>> intersect(room, room).offsets.size
        12
    """
    return Polytope(
        jnp.concatenate([first.normals, second.normals]), jnp.concatenate([first.offsets, second.offsets])
    )
