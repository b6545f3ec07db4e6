"""A safe flight corridor: convex polytopes, each overlapping the next (equation 20)."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from jaxscp.core.arrays import namespace
from jaxscp.core.types import Normals, Offsets, Vector3


class Corridor(eqx.Module):
    """Connected convex polytopes {p : normals p <= offsets}, in flight order.

    Rows are padded to one face count with ``0 . p <= 1``, so that corridors of one shape batch under
    ``vmap``. ``joints[j]`` is a point common to polytopes j and j + 1: the corridor's own proof that it is
    connected, and the way the initial guess takes through it.

    Example:
        >>> import jax.numpy as jnp, jaxscp
        >>> room = jaxscp.corridor.box([0.0, 0.0, 0.0], [4.0, 2.0, 3.0])
        >>> hall = jaxscp.corridor.box([3.0, 0.0, 0.0], [9.0, 2.0, 3.0])
        >>> corridor = jaxscp.corridor.connect([room, hall], joints=[[3.5, 1.0, 1.5]])
        >>> float(corridor.clearance(jnp.array([3.5, 1.0, 1.0]))[0])
        0.5
    """

    normals: Normals
    """Outward unit normals, (polytopes, faces, 3); zero in unused rows."""
    offsets: Offsets
    """Signed distances of the faces from the origin in metres, (polytopes, faces); one in unused rows."""
    joints: Float[Array, "joints 3"]
    """One point in each consecutive overlap in metres, (polytopes - 1, 3)."""

    @property
    def count(self) -> int:
        """Number of polytopes, K."""
        return self.normals.shape[-3]

    def clearance(self, point: Vector3) -> Float[Array, "polytopes"]:
        """Distance in metres from a point to the nearest face of each polytope; negative outside it."""
        return jnp.min(self.offsets - self.normals @ point, axis=-1)


class Polytope(eqx.Module):
    """One convex polytope {p : normals p <= offsets}."""

    normals: Float[Array, "faces 3"]
    """Outward unit normals, (faces, 3)."""
    offsets: Float[Array, "faces"]
    """Signed distances of the faces from the origin in metres, (faces,)."""


def box(lower: ArrayLike, upper: ArrayLike) -> Polytope:
    """Axis-aligned box between two opposite corners in metres.

    Example:
        >>> import jaxscp
        >>> jaxscp.corridor.box([0.0, 0.0, 0.0], [1.0, 2.0, 3.0]).offsets.tolist()
        [1.0, 2.0, 3.0, -0.0, -0.0, -0.0]
    """
    xp = namespace(lower, upper)
    offsets = xp.concatenate([xp.asarray(upper, float), -xp.asarray(lower, float)])
    return Polytope(jnp.asarray(np.concatenate([np.eye(3), -np.eye(3)])), jnp.asarray(offsets))


def connect(polytopes: Sequence[Polytope], joints: ArrayLike) -> Corridor:
    """Chain polytopes into a corridor, padding them to one face count.

    Args:
        polytopes: K polytopes in flight order.
        joints: (K - 1, 3) points, each inside two consecutive polytopes, in metres.
    """
    xp = namespace(polytopes, joints)
    faces = max(polytope.offsets.size for polytope in polytopes)
    pads = [faces - polytope.offsets.size for polytope in polytopes]
    padded = list(zip(polytopes, pads, strict=True))
    normals = [xp.pad(p.normals, ((0, n), (0, 0))) for p, n in padded]
    offsets = [xp.pad(p.offsets, (0, n), constant_values=1.0) for p, n in padded]
    joints = xp.asarray(joints, float).reshape(-1, 3)
    return Corridor(jnp.asarray(xp.stack(normals)), jnp.asarray(xp.stack(offsets)), jnp.asarray(joints))
